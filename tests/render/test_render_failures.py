"""Scenes that cannot be rendered fail alone, and are tried again when the reason is gone."""

import re
import shutil

import pytest
from night_commands import night_here
from render_runs import results


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
    assert render_here(three_missing).stdout.startswith("1 scenes rendered, 6 were there")
    assert results(three_missing) == results(seven_renders)


@pytest.mark.long
def test_scenes_whose_description_is_gone_fail_alone(three_missing, seven_renders, render_here):
    scenes, kept = three_missing / "scenes", three_missing.parent / "kept"
    shutil.copytree(scenes, kept)
    shutil.rmtree(scenes / "000004")
    (scenes / "000005" / "scene.json").unlink()
    done = render_here(three_missing, "--accept", "edited")
    assert done.returncode == 1
    assert done.stdout.startswith("1 scenes rendered, 4 were there")
    assert re.search(r"failed: scene 000004: .*night-gen scenes again", done.stderr)
    assert re.search(r"failed: scene 000005: .*night-gen scenes again", done.stderr)
    status = night_here("night-render", "status", three_missing)
    assert "5 done, 0 running, 2 failed" in status.stdout
    shutil.copytree(kept, scenes, dirs_exist_ok=True)
    assert render_here(three_missing).stdout.startswith("2 scenes rendered, 5 were there")
    assert results(three_missing) == results(seven_renders)
