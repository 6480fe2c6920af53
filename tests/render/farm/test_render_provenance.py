"""``renders/rendering.json`` says how a dataset was rendered; older datasets say it in ``dataset.json``."""

import tomllib

import pytest
from night_commands import PRESET, refusal

from scenegen import RenderingRecord, preset_from_dict, read_rendering_record, write_rendering_record

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


def eight_scenes():
    data = tomllib.loads(PRESET)
    data["dataset"]["count"] = 8
    return preset_from_dict(data, "eight scenes")
