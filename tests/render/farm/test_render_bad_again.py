"""A scene that is bad twice with the same bytes is reported as a defect and is not rendered again."""

import json
import shutil

import numpy as np
import pytest
from night_commands import night_here
from render_records import record_anew
from render_runs import SETTINGS, results

from itof import read_image, write_image
from scenegen import BadRender, read_bad_render, read_record, write_bad_render

SCENE = "000003"


@pytest.fixture
def wrong(rendered_copy):
    """Render folder of a scene whose measurement is wrong, though its record fits."""
    folder = rendered_copy / "renders" / SCENE
    image = read_image(folder / "itof.exr")
    flipped = {name: np.ascontiguousarray(values[:, ::-1]) for name, values in image.channels.items()}
    write_image(folder / "itof.exr", flipped, image.attributes)
    record_anew(folder)
    shutil.copytree(folder, rendered_copy.parent / "wrong")
    return folder


def verify(data, *options):
    """Exit code, result and sentences of a verification."""
    done = night_here("night-render", "verify", data, "--json", *options)
    return done.returncode, json.loads(done.stdout), done.stderr


def status(data):
    return json.loads(night_here("night-render", "status", data, "--json").stdout)


def render_the_same_bytes(folder, data):
    """Leave what a program leaves whose render is wrong in the same way each time."""
    shutil.copytree(data.parent / "wrong", folder, dirs_exist_ok=True)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_scene_that_is_bad_twice_with_the_same_bytes_is_a_defect_and_stays(rendered_copy, wrong, workers):
    code, first, said = verify(rendered_copy, "--workers", workers)
    assert (code, first["good"], first["bad"], first["defects"]) == (1, 6, 1, [])
    assert "the next night-render renders the bad ones again" in said
    assert read_record(wrong) is None
    assert (status(rendered_copy)["missing"], status(rendered_copy)["defects"]) == (1, {})

    render_the_same_bytes(wrong, rendered_copy)
    for _ in range(2):
        code, again, said = verify(rendered_copy, "--workers", workers)
        assert (code, again["good"], again["bad"], again["defects"]) == (1, 6, 1, [SCENE])
        assert again["problems"] == first["problems"]
        assert (
            f"bad again: {SCENE}: it was rendered twice with the same bytes and is not rendered again" in said
        )
        assert "a defect of NIGHT" in said
        assert "the next night-render" not in said
        assert read_record(wrong) is not None
    found = status(rendered_copy)
    assert (found["done"], found["missing"], list(found["defects"])) == (7, 0, [SCENE])
    assert first["problems"][SCENE][0] in found["defects"][SCENE]
    assert (
        f"bad again: {SCENE}: it has the bytes" in night_here("night-render", "status", rendered_copy).stdout
    )
    assert "nothing to render" in night_here("night-render", rendered_copy, *SETTINGS, "--dry-run").stdout


@pytest.mark.long
def test_a_render_with_other_bytes_makes_a_bad_one_forgotten(
    rendered_copy, wrong, seven_renders, render_here
):
    assert verify(rendered_copy)[1]["defects"] == []
    assert read_bad_render(wrong) is not None
    assert render_here(rendered_copy).stdout.startswith("1 scene rendered, 6 were there")
    assert read_bad_render(wrong) is None
    assert results(rendered_copy) == results(seven_renders)
    assert verify(rendered_copy)[0] == 0


@pytest.mark.long
def test_a_render_with_the_same_bytes_is_remembered_until_it_is_found_good(rendered_copy, render_here):
    # As after a wrong check, which a new version of the program has repaired.
    folder = rendered_copy / "renders" / SCENE
    record = read_record(folder)
    write_bad_render(folder, BadRender(record.recipe, record.files, ("the check was wrong",)))
    (folder / "render.json").unlink()
    assert render_here(rendered_copy).stdout.startswith("1 scene rendered, 6 were there")
    assert status(rendered_copy)["defects"] == {SCENE: "the check was wrong"}
    assert verify(rendered_copy)[0] == 0
    assert read_bad_render(folder) is None
    assert status(rendered_copy)["defects"] == {}


def test_damage_on_the_disk_is_repaired_each_time(rendered_copy, wrong):
    verify(rendered_copy, "--only", SCENE)
    render_the_same_bytes(wrong, rendered_copy)
    file = wrong / "itof.exr"
    file.write_bytes(file.read_bytes()[:-10])
    other = rendered_copy / "renders" / "000001"
    shutil.copy(rendered_copy / "renders" / "000002" / "itof.exr", other / "itof.exr")
    _, found, _ = verify(rendered_copy, "--only", SCENE, "--only", "000001")
    assert (set(found["problems"]), found["defects"]) == ({SCENE, "000001"}, [])
    assert read_record(wrong) is None
    assert read_bad_render(other) is None


def test_a_damaged_memory_counts_as_none(rendered_copy, wrong):
    (wrong / "bad.json").write_text('{"files": {"../x": 1}}')
    assert status(rendered_copy)["defects"] == {}
    only = ("--only", SCENE)
    assert verify(rendered_copy, *only)[1]["defects"] == []
    render_the_same_bytes(wrong, rendered_copy)
    assert verify(rendered_copy, *only)[1]["defects"] == [SCENE]
