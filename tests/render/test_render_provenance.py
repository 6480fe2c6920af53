"""``renders/rendering.json`` says how a dataset was rendered; older datasets say it in ``dataset.json``."""

import json
import tomllib

import pytest
from night_commands import PRESET, night_here, refusal
from render_runs import results

from render.options import ManyLightOptions
from render.settings import RenderSettings, settings_of
from scenegen import (
    RenderingRecord,
    open_dataset,
    preset_from_dict,
    read_rendering_record,
    write_rendering_record,
)
from scenegen.making.generation import generate

RECORD = RenderingRecord(
    method="path",
    product="itof",
    max_bounces=4,
    options={"spp": 16},
    width=12,
    height=9,
    packages={"mitsuba": "3.9.1"},
    scene_count=3,
    hidden_error_median=None,
    hidden_error_max=0.25,
)


def make_old(data, schema):
    """Turn a dataset into one of an earlier schema: ``dataset.json`` holds the provenance of its renders."""
    own_file = data / "renders" / "rendering.json"
    rendering = json.loads(own_file.read_text())
    own_file.unlink()
    del rendering["schema_version"]
    rendering["options"] = {"spp": 4096, "lights": None, "error": 0.05}  # those of all methods
    index = json.loads((data / "dataset.json").read_text())
    index |= {"rendering": rendering, "schema_version": schema}
    for scene in index["scenes"]:
        del scene["sha256"]
    if schema == 1:
        del index["packages"], index["meshes"]
    (data / "dataset.json").write_text(json.dumps(index))


def test_a_record_is_read_as_it_was_written(tmp_path):
    assert read_rendering_record(tmp_path) is None
    write_rendering_record(tmp_path, RECORD)
    assert read_rendering_record(tmp_path) == RECORD


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "Invalid JSON"),
        ('{"method": "path"}', "key product is missing"),
        ('{"methods": "path"}', "key method is missing"),
    ],
)
def test_a_damaged_record_is_named(rendered_copy, text, words):
    (rendered_copy / "renders" / "rendering.json").write_text(text)
    sentence = refusal("night-render", "status", rendered_copy)
    assert "rendering.json" in sentence
    assert words in sentence


@pytest.mark.parametrize("schema", [1, 2])
def test_a_dataset_of_an_earlier_schema_is_rendered_with_the_settings_that_it_names(
    rendered_copy, seven_renders, render_here, schema
):
    make_old(rendered_copy, schema)
    before = (rendered_copy / "dataset.json").read_bytes()
    old = open_dataset(rendered_copy)
    assert settings_of(old.rendering, old) == RenderSettings("both", ManyLightOptions(error=0.05))
    assert "7 done" in night_here("night-render", "status", rendered_copy).stdout
    assert render_here(rendered_copy).stdout.startswith("0 scenes rendered, 7 were there")
    assert (rendered_copy / "dataset.json").read_bytes() == before  # night-gen alone writes it
    record = "renders/rendering.json"
    assert results(rendered_copy)[record] == results(seven_renders)[record]


@pytest.mark.parametrize("schema", [1, 2])
def test_extending_a_dataset_of_an_earlier_schema_moves_its_provenance(rendered_copy, maker, schema):
    make_old(rendered_copy, schema)
    old = open_dataset(rendered_copy)
    extended = generate(rendered_copy, eight_scenes(), maker, lambda: None)
    assert extended.rendering == old.rendering
    index = json.loads((rendered_copy / "dataset.json").read_text())
    assert index["schema_version"] == 4
    assert all(scene["sha256"] for scene in index["scenes"])
    assert "rendering" not in index
    assert read_rendering_record(rendered_copy / "renders") == old.rendering
    status = night_here("night-render", "status", rendered_copy).stdout
    assert status.startswith("8 scenes: 7 done, 0 running, 0 failed, 1 missing")


def test_a_newer_record_is_not_replaced_by_the_one_in_dataset_json(rendered_copy, maker):
    make_old(rendered_copy, 2)
    write_rendering_record(rendered_copy / "renders", RECORD)
    assert open_dataset(rendered_copy).rendering == RECORD
    assert generate(rendered_copy, eight_scenes(), maker, lambda: None).rendering == RECORD


def eight_scenes():
    data = tomllib.loads(PRESET)
    data["dataset"]["count"] = 8
    return preset_from_dict(data, "eight scenes")
