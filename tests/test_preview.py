"""Previews: Blender's view of a scene, what a contact sheet shows, counts, and the dataset card."""

import dataclasses
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import bpy
import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from matplotlib import image as png

import cli
from itof import amplitude, direct_phasors, phase, read_image, write_image
from render.products.card import CardError, checked_licence, dataset_card, read_card
from render.products.contact_sheet import choose_scenes, contact_sheet, read_tile
from render.products.distributions import distributions_figure, ratio_sentence, read_distributions
from render.products.preview import meshes_in, write_preview
from render.rendering import Renderer
from render.settings import RenderError, RenderSettings
from render.transport.method import MethodOptions
from scenegen import RenderingProvenance, camera_axes, open_dataset, sample_scene, wall_normal, write_index
from scenegen.making.meshes import read_meshes

SIZE = (144, 108)  # of Blender's view: a small object still covers 30 pixels
RENDERED = ("000000", "000001", "000003")
SETTINGS = {
    "dataset": {"count": 9, "seed": 3},
    "camera": {"width": 24, "height": 18},
    "transient": {"bin_count": 1400},
}


@pytest.fixture(scope="module")
def rendered(make_dataset, variant):
    """Nine scenes, three of them rendered; open for reading alone."""
    dataset = make_dataset(SETTINGS)
    renderer = Renderer(dataset, RenderSettings(options=MethodOptions(lights=64), device="cpu"))
    for scene_id in RENDERED:
        renderer.render(scene_id)
    return dataset


@pytest.fixture
def copy(rendered, tmp_path):
    shutil.copytree(rendered.root, tmp_path / "corners")
    return open_dataset(tmp_path / "corners")


@pytest.fixture(scope="module")
def cube(paper):
    """An upright cube in the middle of its range."""
    scene = sample_scene(paper, 0)
    assert scene.object_class == "cube"
    return moved(scene, location_m=(1.15, 0.9, 1.6), rotation_deg=(0.0, 0.0, 0.0))


def moved(scene, **changes):
    return dataclasses.replace(
        scene, hidden_objects=(dataclasses.replace(scene.hidden_objects[0], **changes),)
    )


def grey_view(scene, width, height):
    """Stands in where no view is looked at, to save Blender's second."""
    return np.full((height, width, 3), 128, np.uint8)


def orange(picture):
    """(N, 2) rows and columns of the pixels that only the hidden object can have coloured."""
    red, green, blue = (picture[..., channel].astype(int) for channel in range(3))
    return np.argwhere((red > 100) & (red > 1.5 * green) & (green > blue + 20))


def refusal(*arguments):
    """The one sentence of a preview that must end with exit code 2."""
    result = CliRunner().invoke(cli.night_gen, ["preview", *map(str, arguments)])
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    sentence = result.stderr.removeprefix("Error: ").strip()
    assert "\n" not in sentence
    return sentence


def night_gen(*arguments):
    program = Path(sys.executable).with_name("night-gen")
    words = [str(word) for word in (program, *arguments)]
    return subprocess.run(words, capture_output=True, text=True, check=False, env={**os.environ})


def contents(root):
    return {str(f.relative_to(root)): f.read_bytes() for f in sorted(root.rglob("*")) if f.is_file()}


# Blender's view


def test_the_view_shows_the_object_where_it_is(maker, cube):
    rows, columns = orange(maker.picture(cube, *SIZE)).T
    assert len(rows) > 30
    for location_m, moves in (
        ((1.15, 1.2, 1.6), (0, 1)),  # away from the middle wall is to the right
        ((1.15, 0.6, 1.6), (0, -1)),
        ((1.15, 0.9, 1.9), (-1, 0)),
    ):
        there = orange(maker.picture(moved(cube, location_m=location_m), *SIZE)).mean(axis=0)
        shift = there - (rows.mean(), columns.mean())
        along = shift @ moves
        assert along > 5
        assert along > np.linalg.norm(shift) * np.cos(np.radians(35))  # the view is oblique


def test_without_an_object_nothing_in_the_view_has_its_colour(maker, cube):
    tiny = moved(cube, size_m=(1e-4, 1e-4, 1e-4))
    picture = maker.picture(tiny, *SIZE)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    assert len(orange(picture)) == 0
    red, blue = picture[..., 0].astype(int), picture[..., 2].astype(int)
    assert 0.05 < (blue > red + 60).mean() < 0.5  # the lit part of the wall


def test_a_wider_camera_lights_more_of_the_wall(maker, cube):
    blue = []
    for angle in (20.0, 40.0):
        camera = dataclasses.replace(cube.camera, horizontal_fov_deg=angle)
        picture = maker.picture(dataclasses.replace(cube, camera=camera), *SIZE).astype(int)
        blue.append((picture[..., 2] > picture[..., 0] + 60).mean())
    assert blue[1] > 2 * blue[0]


def test_the_viewpoint_is_the_same_for_all_scenes(maker, cube):
    near, far = (maker.picture(moved(cube, location_m=(1.15, y, 1.6)), *SIZE) for y in (0.6, 1.3))
    corner = np.s_[:36, :36]  # relay wall, far from objects and their shadows
    np.testing.assert_allclose(near[corner].astype(int), far[corner], atol=4)


def test_a_view_leaves_nothing_behind(maker, cube, capfd):
    collections = ("scenes", "worlds", "objects", "cameras", "lights", "materials", "images", "meshes")
    before = {name: len(getattr(bpy.data, name)) for name in collections}
    engine = bpy.context.scene.render.engine
    files = maker.files(cube)
    first = maker.picture(cube, *SIZE)
    assert maker.files(cube) == files
    assert {name: len(getattr(bpy.data, name)) for name in collections} == before
    assert bpy.context.scene.render.engine == engine
    np.testing.assert_array_equal(maker.picture(cube, *SIZE), first)
    assert capfd.readouterr() == ("", "")


# Contact sheet


def test_a_tile_holds_what_was_rendered(rendered):
    for scene_id in RENDERED:
        tile = read_tile(rendered, scene_id, grey_view(None, 4, 3))
        image = read_image(rendered.render_folder(scene_id) / "itof.exr")
        truth = read_image(rendered.render_folder(scene_id) / "mirrored.exr")
        np.testing.assert_array_equal(tile.measured, amplitude(image.phasors()[0])[..., 0])
        np.testing.assert_array_equal(tile.hidden, amplitude(image.phasors("hidden")[0])[..., 0])
        depth_m, mask = truth.channel("depth.R"), truth.channel("mask.M") > 0
        np.testing.assert_array_equal(tile.radial_depth_m[mask], depth_m[mask])
        assert np.isnan(tile.radial_depth_m[~mask]).all()
        entry, roughness = rendered.entry(scene_id), rendered.scene(scene_id).relay_wall.roughness
        words = (scene_id, entry.object_class.replace("_", " "), entry.split, f"roughness {roughness:.2f}")
        assert tile.title.split("   ") == list(words)


def test_the_sheet_draws_the_tiles_arrays_and_says_what_is_not_rendered(rendered):
    tiles = [read_tile(rendered, scene_id, grey_view(None, 4, 3)) for scene_id in ("000000", "000002")]
    figure = contact_sheet(tiles)
    drawn = [panel.images[0].get_array() for panel in figure.axes[:4]]
    for values, expected in zip(drawn, (tiles[0].view, tiles[0].measured, tiles[0].hidden), strict=False):
        np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(np.ma.filled(drawn[3], np.nan), tiles[0].radial_depth_m)
    assert (tiles[1].measured, tiles[1].hidden, tiles[1].radial_depth_m) == (None, None, None)
    for panel in figure.axes[5:8]:
        assert len(panel.images) == 0
        assert [text.get_text() for text in panel.texts if "rendered" in text.get_text()] == ["not rendered"]


def test_without_parts_the_sheet_shows_what_no_direct_light_explains(copy):
    # Light of phase a in front of the wall's own, b behind: only sin(a) and sin(b) of it is no direct light.
    scene = copy.scene("000000")
    wall, camera = scene.relay_wall, scene.camera
    direct = direct_phasors(
        *(24, 18, camera.horizontal_fov_deg, [20e6], camera_axes(camera), camera.location_m),
        *(wall.location_m, wall_normal(wall)),
    )[..., 0]
    lag = np.linspace(0, 1, 24)[None, :] * np.ones((18, 1))
    phasor = 0.7 * direct + 0.01 * np.exp(1j * (phase(direct) + lag))
    channels = {"itof.20MHz.Re": phasor.real, "itof.20MHz.Im": phasor.imag}
    write_image(copy.render_folder("000000") / "itof.exr", channels, {})
    tile = read_tile(copy, "000000", grey_view(None, 4, 3))
    assert tile.hidden_is_residual
    np.testing.assert_allclose(tile.hidden, 0.01 * np.sin(lag), atol=1e-6 * np.abs(phasor).max())
    headings = {text.get_text() for panel in contact_sheet([tile]).axes for text in panel.texts}
    assert "residual of the wall" in headings


def test_scenes_are_chosen_evenly_over_classes_and_splits(make_dataset):
    dataset = make_dataset({"dataset": {"count": 70}})
    chosen = choose_scenes(dataset, 14)
    assert chosen == sorted(set(chosen))
    entries = [dataset.entry(scene_id) for scene_id in chosen]
    assert set(Counter(entry.object_class for entry in entries).values()) == {2}
    splits = Counter(entry.split for entry in entries)
    assert min(splits[split] for split in ("train", "validation", "test")) >= 4
    assert choose_scenes(dataset, 99) == dataset.ids()


def test_rendered_scenes_are_chosen_first_within_a_class(rendered):
    assert set(RENDERED) <= set(choose_scenes(rendered, 7))
    assert choose_scenes(rendered, 9) == rendered.ids()


# Distributions


def test_the_pixel_ratio_is_that_of_the_masks(rendered):
    steps = []
    found = read_distributions(rendered, lambda: steps.append(1))
    assert len(steps) == 9
    masks = [read_image(rendered.render_folder(i) / "mirrored.exr").channel("mask.M") for i in RENDERED]
    background, on_object = sum((m == 0).sum() for m in masks), sum((m == 1).sum() for m in masks)
    assert found.background_ratio == pytest.approx(background / on_object, rel=1e-12)
    assert found.object_pixels == {i: m.sum() for i, m in zip(RENDERED, masks, strict=True)}
    assert found.image_sizes == ((24, 18),)
    assert ratio_sentence(found) == f"background/object {background / on_object:.1f} (paper: 30.2)"


def test_every_drawn_object_falls_into_a_bin(rendered):
    found = read_distributions(rendered, lambda: None)
    scenes = [rendered.scene(scene_id) for scene_id in rendered.ids()]
    places = [scene.hidden_objects[0].location_m for scene in scenes]
    np.testing.assert_array_equal(found.locations_m, places)
    parts = sum(len(scene.hidden_objects) for scene in scenes)
    assert parts > len(scenes)  # a composite is among them
    panels = distributions_figure(found, rendered.preset).axes
    for panel in panels[:6]:
        # Bars of a stack start where the one below ends, so their heights are the counts.
        assert sum(bar.get_height() for bar in panel.patches) == parts
        low, high = sorted(line.get_xdata()[0] for line in panel.lines)
        ranges = rendered.preset.hidden_object
        group = ranges.location_m if "position" in panel.get_xlabel() else ranges.rotation_deg
        assert (low, high) == getattr(group, panel.get_xlabel().split()[1].rstrip(","))
    assert sum(bar.get_height() for bar in panels[6].patches) == len(scenes)
    assert sum(bar.get_width() for bar in panels[7].patches) == len(scenes)
    assert sum(bar.get_height() for bar in panels[8].patches) == len(RENDERED)


def test_a_point_for_a_range_and_a_diffuse_wall_can_be_drawn(make_dataset):
    point = {"x": [1.1, 1.1], "y": [0.9, 0.9], "z": [1.6, 1.6]}
    settings = {"composite_fraction": 0.0, "location_m": point}
    dataset = make_dataset(
        {"dataset": {"count": 3}, "hidden_object": settings, "relay_wall": {"material": "diffuse"}}
    )
    found = read_distributions(dataset, lambda: None)
    assert found.background_ratio is None
    assert ratio_sentence(found) == "no scene is rendered yet"
    figure = distributions_figure(found, dataset.preset)
    assert sum(bar.get_height() for bar in figure.axes[0].patches) == 3
    assert "diffuse" in figure.axes[6].texts[0].get_text()
    assert "no scene is rendered yet" in figure.axes[8].texts[0].get_text()
    figure.savefig(os.devnull, format="png")


# The card


def test_the_cards_numbers_are_the_datasets(copy):
    rendering = RenderingProvenance(
        method="many-light",
        product="itof",
        max_bounces=3,
        options={"lights": 64, "error": 0.01, "spp": None},
        width=24,
        height=18,
        packages={"mitsuba": "3.9.9"},
        scene_count=3,
        hidden_error_median=0.0123,
        hidden_error_max=0.0456,
    )
    write_index(copy.root, dataclasses.replace(copy.index, rendering=rendering))
    dataset = open_dataset(copy.root)
    found = read_distributions(dataset, lambda: None)
    card = dataset_card(dataset, found, None)
    assert card.startswith("# corners\n")
    assert "9 synthetic look-behind-a-corner scenes, 3 of them rendered" in card
    for name in sorted({entry.object_class for entry in dataset.index.scenes}):
        members = [entry.split for entry in dataset.index.scenes if entry.object_class == name]
        counts = [members.count(split) for split in ("train", "validation", "test")]
        assert f"| {name} | {counts[0]} | {counts[1]} | {counts[2]} | {len(members)} |" in card
    assert "24 x 18 pixels asked for, 24 x 18 rendered" in card
    assert "1400 bins of 0.01 m" in card
    assert "median 1.23%, at most 4.56%" in card
    assert "method many-light (lights 64, error 0.01), product itof" in card
    assert "mitsuba 3.9.9" in card
    assert ratio_sentence(found) in card
    size = sum(f.stat().st_size for f in (copy.root / "renders").rglob("*") if f.is_file())
    unit = 1000 if size < 999_500 else 1_000_000
    assert f"renders {size / unit:.3g} {'kB' if unit == 1000 else 'MB'}" in card
    assert "preset key `transient.bin_count` | `1400`" in card
    assert "preset key `dataset.seed` | `3`" in card
    assert "None has been chosen yet" in card
    assert str(copy.root.parent) not in card
    assert not re.search(r"\s/\w", card)  # no absolute path


def test_the_cards_snippet_runs_in_the_datasets_folder(copy):
    card = dataset_card(copy, read_distributions(copy, lambda: None), None)
    snippet = re.search(r"```python\n(.*?)```", card, re.DOTALL)[1]
    check = "\nassert z.shape == (18, 24, 3) and wall_depth_m.shape == hidden_depth_m.shape == (18, 24)"
    command = [sys.executable, "-c", snippet + check]
    done = subprocess.run(command, cwd=copy.root, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_licence_is_kept_until_another_is_given(copy):
    # The third would end the comment that keeps it.
    for licence in ("CC BY 4.0", "CC-BY-SA 4.0 | ours", "a --> b -- c"):
        write_preview(copy, ["000002"], grey_view, licence)
        assert read_card(copy).licence == licence
        before = (copy.root / "README.md").read_text()
        assert f"## Licence\n\n{licence}\n" in before
        assert len(re.findall("-->", before.split("## Licence")[0])) == 1
        write_preview(copy, ["000002"], grey_view)
        assert (copy.root / "README.md").read_text() == before
    with pytest.raises(CardError, match="name of a licence"):
        checked_licence(" ")


@pytest.mark.parametrize("text", ["# My notes\n", ""])
def test_a_readme_of_somebody_else_is_kept(copy, text):
    (copy.root / "README.md").write_text(text)
    written = write_preview(copy, ["000000"], grey_view, "CC BY 4.0")
    assert (copy.root / "README.md").read_text() == text
    assert [file.name for file in written] == ["contact_sheet.png", "distributions.png"]


# The command


def test_the_command_leaves_scenes_renders_and_night_gen_alone(copy):
    before = contents(copy.root)
    (copy.root / "README.md").write_text("mine")
    done = night_gen("preview", copy.root, "--only", "000003", "--only", "000002")
    assert done.returncode == 0, done.stderr
    pictures = [copy.root / "preview" / name for name in ("contact_sheet.png", "distributions.png")]
    assert done.stdout.splitlines() == [str(file) for file in pictures]
    assert "README.md is not ours and was left alone" in done.stderr
    (copy.root / "README.md").unlink()
    done = night_gen("preview", copy.root, "--count", 1, "--licence", "CC0")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == str(copy.root / "README.md")
    for file in pictures:
        sheet = png.imread(file)
        assert sheet[..., :3].std() > 0.05  # not blank
    orange_ones = orange(np.round(255 * png.imread(pictures[0])).astype(int))
    assert len(orange_ones) > 30  # Blender's view is in the sheet
    (copy.root / "preset.toml").write_text(
        "[dataset]\ncount = 9\nseed = 3\n[camera]\nwidth = 24\nheight = 18\n[transient]\nbin_count = 1400\n"
    )
    again = night_gen("scenes", copy.root, "--preset", copy.root / "preset.toml")
    assert again.returncode == 0, again.stderr
    (copy.root / "preset.toml").unlink()
    after = contents(copy.root)
    added = {"README.md", "preview/contact_sheet.png", "preview/distributions.png"}
    assert {name: data for name, data in after.items() if name not in added} == before


def test_what_cannot_be_previewed_is_refused(copy, tmp_path):
    assert "no folder" in refusal(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "no NIGHT dataset" in refusal(tmp_path / "empty")
    assert "no scene 000099" in refusal(copy.root, "--only", "000099")
    assert "name of a licence" in refusal(copy.root, "--licence", "")
    file = copy.render_folder("000001") / "mirrored.exr"
    whole = file.read_bytes()
    file.write_bytes(whole[:-300])
    assert "damaged or no EXR" in refusal(copy.root)
    write_image(file, {"R": np.ones((18, 24))}, {})
    assert "scene 000001: mirrored.exr is no render of NIGHT" in refusal(copy.root)
    file.write_bytes(whole)
    write_image(copy.render_folder("000001") / "itof.exr", {"itof.20MHz.Re": np.ones((18, 24))}, {})
    assert "scene 000001: itof.exr is no render of NIGHT" in refusal(copy.root)
    nan = np.full((18, 24), np.nan)
    write_image(copy.render_folder("000001") / "itof.exr", {"itof.20MHz.Re": nan, "itof.20MHz.Im": nan}, {})
    assert "NaN" in refusal(copy.root)
    assert not (copy.root / "preview").exists()
    assert not (copy.root / "README.md").exists()


# Meshes of the user's own


def test_a_users_mesh_is_drawn_from_the_scenes_own_files(tmp_path):
    source = trimesh.creation.annulus(r_min=0.2, r_max=0.6, height=1.0, sections=24)
    source.export(tmp_path / "ring.ply")
    (tmp_path / "ring.toml").write_text(
        '[dataset]\ncount = 2\n[hidden_object]\nshapes = ["mesh:ring.ply"]\ncomposite_fraction = 0.0\n'
        "[camera]\nwidth = 24\nheight = 18\n"
    )
    done = night_gen("scenes", tmp_path / "rings", "--preset", tmp_path / "ring.toml")
    assert done.returncode == 0, done.stderr
    dataset = open_dataset(tmp_path / "rings")
    original = read_meshes(dataset.preset, tmp_path)["mesh:ring.ply"]
    (tmp_path / "ring.ply").unlink()
    found = meshes_in(dataset)["mesh:ring.ply"]
    assert found.sha256 == original.sha256
    # Places came through float32 in a room of metres: 1e-7 m, in units of a 0.5 m box.
    np.testing.assert_allclose(found.vertices, original.vertices, atol=2e-6)
    assert sorted(map(sorted, found.triangles.tolist())) == sorted(map(sorted, original.triangles.tolist()))
    done = night_gen("preview", tmp_path / "rings")
    assert done.returncode == 0, done.stderr
    sheet = np.round(255 * png.imread(tmp_path / "rings" / "preview" / "contact_sheet.png")).astype(int)
    assert len(orange(sheet)) > 100
    (dataset.scene_folder("000000") / "hidden_object_0.ply").unlink()
    with pytest.raises(RenderError, match="run night-gen scenes again"):
        meshes_in(dataset)
