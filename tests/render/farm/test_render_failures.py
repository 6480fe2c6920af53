"""Scenes that cannot be rendered fail alone, and are tried again when the reason is gone."""

import re
import shutil

import pytest
from night_commands import night_here
from render_runs import results

from render.farm.run_result import failure_lines
from scenegen import preset_from_dict
from scenegen.making.generation import generate


@pytest.mark.long
def test_a_scene_that_cannot_be_rendered_leaves_the_others_alone(three_missing, seven_renders, render_here):
    mesh = three_missing / "scenes" / "000004" / "hidden_object_0.ply"
    whole = mesh.read_bytes()
    mesh.write_bytes(whole[: len(whole) // 2])
    done = render_here(three_missing, "--accept", "edited")
    assert done.returncode == 1
    assert done.stdout.startswith("2 scenes rendered, 4 were there")
    assert "000004" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Traceback" in (three_missing / "renders" / "000004" / "failure.log").read_text()
    mesh.write_bytes(whole)  # another scene than the one that failed: no --again failed needed
    assert render_here(three_missing).stdout.startswith("1 scene rendered, 6 were there")
    assert results(three_missing) == results(seven_renders)


@pytest.mark.long
def test_scenes_whose_description_is_gone_fail_alone(three_missing, seven_renders, render_here):
    scenes, kept = three_missing / "scenes", three_missing.parent / "kept"
    shutil.copytree(scenes, kept)
    shutil.rmtree(scenes / "000004")
    (scenes / "000005" / "scene.json").unlink()
    done = render_here(three_missing, "--accept", "edited")
    assert done.returncode == 1
    assert done.stdout.startswith("1 scene rendered, 4 were there")
    assert re.search(r"failed: scene 000004: .*night-gen scenes again", done.stderr)
    assert re.search(r"failed: scene 000005: .*night-gen scenes again", done.stderr)
    status = night_here("night-render", "status", three_missing)
    assert "5 done, 0 running, 2 failed" in status.stdout
    shutil.copytree(kept, scenes, dirs_exist_ok=True)
    assert render_here(three_missing).stdout.startswith("2 scenes rendered, 5 were there")
    assert results(three_missing) == results(seven_renders)


def test_a_reason_that_scenes_share_is_said_once():
    reasons = {f"{i:06d}": f"/data/{i:06d}/a.ply is 0.{i + 1} m away: move it" for i in range(12)}
    shared, own = failure_lines(reasons | {"000003": "its worker died"})
    listed = "000000, 000001, 000002, 000004, 000005, 000006, 000007, 000008, 000009, 000010, ..."
    assert shared == f"failed: scene 000000: {reasons['000000']} (11 scenes: {listed})"
    assert own == "failed: scene 000003: its worker died"


def test_scenes_without_hidden_light_fail_with_one_sentence(maker, tmp_path, render_here):
    """Such as those of a closed corner, which earlier versions of night-gen made."""
    tables = {"dataset": {"count": 3}, "camera": {"width": 24, "height": 18}}
    closed = preset_from_dict(tables | {"middle_wall": {"location_m": [1.6, 0.0, 2.0]}}, "test")
    generate(tmp_path / "closed", closed, maker, lambda: None)
    done = render_here(tmp_path / "closed", "--product", "itof", "--error", "0.1")
    assert done.returncode == 1
    assert done.stderr.count("failed: ") == 1
    words = "no hidden object can be seen from the lit relay wall: widen the gap that the middle wall leaves"
    assert words in done.stderr
    assert "(3 scenes: 000000, 000001, 000002)" in done.stderr
