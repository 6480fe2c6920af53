"""Settings of a run: those of before where none are given, refused where they do not fit, kept on record."""

import json
import re
import shutil
from dataclasses import replace

import pytest
from night_commands import night_here, refusal
from render_runs import SETTINGS, results

from itof import read_image
from render.options import ManyLightOptions, PathOptions
from render.settings import RenderSettings
from scenegen import open_dataset, read_record, write_record

FEWER = ["--lights", "64", "--device", "cpu"]


def test_other_settings_replace_nothing_unasked(rendered_copy, seven_renders, render_here):
    refused = render_here(rendered_copy, *FEWER)
    assert refused.returncode == 2
    assert "--again changed" in refused.stderr
    assert results(rendered_copy) == results(seven_renders)
    assert render_here(rendered_copy).stdout.startswith("0 scenes rendered, 7 were there")
    done = render_here(rendered_copy, "--again", "changed", "--only", "000003", *FEWER)
    assert done.stdout.startswith("1 scene rendered")
    assert '"lights": 64' in read_record(rendered_copy / "renders" / "000003").recipe


def test_some_scenes_do_not_get_other_settings_than_the_rest(rendered_copy, render_here):
    shutil.rmtree(rendered_copy / "renders" / "000003")
    before = results(rendered_copy)
    refused = render_here(rendered_copy, "--only", "000003", *FEWER)
    assert refused.returncode == 2
    assert "scene 000000 of" in refused.stderr
    assert "all scenes of a dataset have the same" in refused.stderr
    assert results(rendered_copy) == before
    assert render_here(rendered_copy, "--only", "000003").stdout.startswith("1 scene rendered")


def test_a_recorded_size_that_does_not_fit_the_camera_names_the_file(rendered_copy):
    file = rendered_copy / "renders" / "rendering.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "height": 2**29}))
    assert "rendering.json cannot be used" in refusal("night-render", "status", rendered_copy)


def test_the_small_product_is_the_images_of_the_large_one_alone(unrendered, seven_renders, render_here):
    done = render_here(
        unrendered, *SETTINGS, "--product", "itof", "--method", "many-light", "--only", "000003"
    )
    assert done.returncode == 0, done.stderr
    files = {file.name: file.read_bytes() for file in (unrendered / "renders" / "000003").iterdir()}
    assert set(files) == {"itof.exr", "mirrored.exr", "render.json"}
    for name in ("itof.exr", "mirrored.exr"):
        assert files[name] == (seven_renders / "renders" / "000003" / name).read_bytes()


@pytest.mark.long
def test_transients_can_be_dropped_and_a_larger_product_adds_them_again(
    rendered_copy, seven_renders, render_here
):
    done = night_here("night-render", "drop-transients", rendered_copy, "--yes")
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"[\d.]+ MB freed: the transients of 7 scenes are deleted\n", done.stdout)
    assert not list(rendered_copy.glob("renders/*/*transient.exr"))
    assert "7 good, 0 bad" in night_here("night-render", "verify", rendered_copy).stdout
    assert render_here(rendered_copy).stdout.startswith("0 scenes rendered, 7 were there")

    more = render_here(rendered_copy, "--product", "both", "--only", "000003")
    assert more.stdout.startswith("1 scene rendered")
    # Transients of one scene do not mean that all scenes should have them.
    assert render_here(rendered_copy).stdout.startswith("0 scenes rendered, 7 were there")
    rest = render_here(rendered_copy, "--product", "both")
    assert rest.stdout.startswith("6 scenes rendered, 1 were there")
    assert results(rendered_copy) == results(seven_renders)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--spp", "16"], "--spp is an option of method path, and the method is many-light"),
        (["--method", "path", "--lights", "64"], "--lights is an option of method many-light"),
        (["--method", "path", "--error", "0.1"], "--error is an option of method many-light"),
    ],
)
def test_an_option_of_another_method_is_refused(rendered_copy, arguments, words):
    for command in (["night-render"], ["night-render", "status"]):
        assert words in refusal(*command, rendered_copy, *arguments)


@pytest.mark.parametrize(
    ("options", "words"),
    [({"foo": 1}, "foo is not an option of any method"), ({"error": None}, "not supported between")],
)
def test_a_dataset_rendered_in_an_unknown_way_is_refused(rendered_copy, options, words):
    record = json.loads((rendered_copy / "renders/rendering.json").read_text())
    record["options"] = options
    (rendered_copy / "renders/rendering.json").write_text(json.dumps(record))
    for command in (["night-render"], ["night-render", "status"]):
        sentence = refusal(*command, rendered_copy)
        assert "rendering.json cannot be used" in sentence
        assert words in sentence


def test_the_dataset_says_how_and_how_well_it_was_rendered(seven_renders):
    dataset = open_dataset(seven_renders)
    made = dataset.rendering
    assert (made.method, made.product, made.width, made.height) == ("many-light", "both", 24, 18)
    assert made.options == {"lights": None, "error": 0.05}
    assert made.scene_count == 7
    assert made.packages["mitsuba"]
    errors = [
        float(read_image(dataset.render_folder(scene) / "itof.exr").attributes["hidden_error"])
        for scene in dataset.ids()
    ]
    assert made.hidden_error_max == max(errors)
    assert made.hidden_error_median == sorted(errors)[3]


@pytest.mark.parametrize(
    ("options", "listed"),
    [
        (ManyLightOptions(error=0.05), {"spp": 4096, "lights": None, "error": 0.05}),
        (ManyLightOptions(lights=64), {"spp": 4096, "lights": 64, "error": 0.01}),
        (PathOptions(spp=16), {"spp": 16, "lights": None, "error": 0.01}),
    ],
)
def test_a_recipe_lists_the_options_of_both_methods_so_that_old_renders_stay_valid(
    seven_scenes, options, listed
):
    dataset = open_dataset(seven_scenes)
    recipe = json.loads(RenderSettings(options=options).recipe(dataset, "0" * 64))
    assert recipe["options"] == listed
    assert list(recipe["options"]) == ["spp", "lights", "error"]  # recipes are compared as text
    assert recipe["method"] == options.method


@pytest.mark.parametrize(
    ("options", "divisions"),
    [
        (ManyLightOptions(), 7),
        (ManyLightOptions(error=0.0005), 7),
        (ManyLightOptions(error=0.028), 7),
        (ManyLightOptions(error=0.029), 6),
        (ManyLightOptions(error=0.08), 5),
        (ManyLightOptions(error=0.5), 4),
        (ManyLightOptions(lights=64, error=0.5), 7),  # the error decides nothing
        (PathOptions(), 7),
    ],
)
def test_pixels_with_edges_are_divided_for_the_error_and_the_recipe_says_so(unrendered, options, divisions):
    dataset = open_dataset(unrendered)
    assert options.edge_divisions == divisions
    recipe = json.loads(RenderSettings(options=options).recipe(dataset, "0" * 64))
    assert recipe.get("edge_divisions") == (divisions if divisions < 7 else None)


def test_renders_of_versions_that_divided_every_edge_finely_are_not_made_again(rendered_copy, render_here):
    for scene_id in open_dataset(rendered_copy).ids():
        folder = rendered_copy / "renders" / scene_id
        record = read_record(folder)
        assert '"edge_divisions": 6, ' in record.recipe
        write_record(folder, replace(record, recipe=record.recipe.replace('"edge_divisions": 6, ', "")))
    assert render_here(rendered_copy).stdout.startswith("0 scenes rendered, 7 were there")
    refused = render_here(rendered_copy, "--error", "0.1")
    assert "--again changed" in refused.stderr
