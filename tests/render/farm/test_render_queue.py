"""Several commands at one dataset: they share the work, agree on what fails, and keep to their settings."""

import re
import shutil

import pytest
from night_commands import night_here
from render_runs import results, run_log, start_render, wait_for

from render.farm.claims import claimed

BROKEN = "000001"  # a scene whose mesh is cut off


@pytest.fixture(scope="module")
def both(seven_scenes, render_cluster, tmp_path_factory):
    """Two commands rendering one dataset at the same time: its folder, and code and output of each."""
    data = shutil.copytree(seven_scenes, tmp_path_factory.mktemp("both") / "data")
    mesh = data / "scenes" / BROKEN / "hidden_object_0.ply"
    mesh.write_bytes(mesh.read_bytes()[:200])
    processes = [start_render(data, "--accept", "edited", "--cluster", render_cluster) for _ in range(2)]
    outputs = [process.communicate(timeout=600) for process in processes]
    return data, [(process.returncode, *output) for process, output in zip(processes, outputs, strict=True)]


@pytest.mark.long
def test_two_commands_at_once_share_the_work(both, seven_renders):
    data, ended = both
    counts = [re.match(r"(\d+) scenes? rendered, (\d+) were there", output) for _, output, _ in ended]
    assert sum(int(match[1]) for match in counts) == 6  # no scene twice
    assert all(int(match[1]) + int(match[2]) == 6 for match in counts)
    files, expected = results(data), results(seven_renders)
    whole = [name for name in expected if name.endswith(".exr") and BROKEN not in name]
    assert len(whole) == 24
    assert {name: files[name] for name in whole} == {name: expected[name] for name in whole}


@pytest.mark.long
def test_two_commands_agree_that_a_scene_cannot_be_rendered(both):
    data, ended = both
    assert [code for code, _, _ in ended] == [1, 1], ended
    assert all(f"failed: scene {BROKEN}" in errors for _, _, errors in ended)
    assert len(re.findall(f"{BROKEN} failed on", run_log(data))) <= 4  # two attempts each


@pytest.mark.long
def test_a_command_with_other_settings_does_not_disturb_a_run(three_missing, seven_renders, render_cluster):
    with claimed(three_missing / "renders", "000006"):  # the run waits for this scene
        first = start_render(three_missing, "--cluster", render_cluster)
        wait_for((three_missing / "renders" / "000005" / "render.json").exists)
        wait_for((three_missing / "renders" / "000004" / "render.json").exists)
        status = night_here("night-render", "status", three_missing)
        second = night_here("night-render", three_missing, "--lights", 64, "--device", "cpu")
    assert second.returncode == 2
    assert "another night-render is rendering" in second.stderr
    assert status.stdout.startswith("7 scenes: 6 done, 1 running, 0 failed, 0 missing")
    output, errors = first.communicate(timeout=600)
    assert first.returncode == 0, errors
    assert output.startswith("3 scenes rendered, 4 were there")
    assert results(three_missing) == results(seven_renders)
