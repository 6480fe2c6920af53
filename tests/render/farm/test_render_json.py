"""``night-render --json``: the result as one object on stdout, whose keys docs/reference/files.md lists."""

import json
import re
import shutil

import pytest
from night_commands import night_here, refusal
from render_runs import SETTINGS
from source_tree import ROOT

from render.farm.claims import claimed

RUN = {
    *("renders", "rendered", "present", "failed", "skipped_failures", "failures", "settings", "plan"),
    "hidden_error_max",
}
SETTING = {"product", "device", "method", "options", "max_bounces", "size", "bins", "frequencies_hz"}
PLAN = {"scenes", "image_bytes_per_scene", "transient_bytes_per_scene", "needed_bytes", "free_bytes"}
STATUS = {
    *("scenes", "done", "failed", "missing", "damaged", "other_settings", "edited", "running", "failures"),
    *("used_bytes", "free_bytes", "scenes_per_hour", "seconds_left", "defects"),
}
VERIFICATION = {"good", "bad", "not_rendered", "not_checked", "problems", "damaged_scenes", "defects"}


def result(done):
    """The one object on stdout."""
    (line,) = done.stdout.splitlines()
    return json.loads(line)


def test_a_run_and_its_plan_as_json(three_missing, render_here):
    planned = result(night_here("night-render", three_missing, "--dry-run", "--json"))
    done = render_here(three_missing, "--only", "000003", "--only", "000004", "--json")
    assert done.returncode == 0, done.stderr
    found = result(done)
    assert found.keys() == planned.keys() == RUN
    assert found["settings"].keys() == SETTING
    assert found["plan"].keys() == planned["plan"].keys() == PLAN
    assert (found["rendered"], found["present"], found["failed"], found["failures"]) == (1, 1, 0, {})
    assert (planned["rendered"], planned["present"]) == (0, 4)
    assert (found["plan"]["scenes"], planned["plan"]["scenes"]) == (1, 3)
    assert found["settings"]["method"] == "many-light"
    assert found["settings"]["size"] == [24, 18]
    assert found["renders"] == str(three_missing / "renders")
    assert "1 scene rendered, 1 were there already" in done.stderr
    record = json.loads((three_missing / "renders" / "rendering.json").read_text())
    assert found["hidden_error_max"] == record["hidden_error_max"] <= record["options"]["error"] == 0.05
    assert "asked for" not in done.stderr


def test_a_run_says_that_a_scene_misses_the_wanted_error(rendered_copy):
    record = rendered_copy / "renders" / "000002" / "render.json"
    data = json.loads(record.read_text())
    data["attributes"]["hidden_error"] = "0.0731"
    record.write_text(json.dumps(data))
    done = night_here("night-render", rendered_copy, *SETTINGS)
    assert done.returncode == 0, done.stderr
    assert "of up to 0.0731, but 0.05 was asked for" in done.stdout
    assert f"{rendered_copy / 'renders' / 'night-render.log'} names them" in done.stdout


def test_a_run_without_work_has_no_plan(seven_renders):
    done = night_here("night-render", seven_renders, *SETTINGS, "--dry-run", "--json")
    found = result(done)
    assert (found["plan"], found["present"]) == (None, 7)
    assert "nothing to render" in done.stderr


def test_the_status_as_json(three_missing):
    done = night_here("night-render", "status", three_missing, "--json")
    found = result(done)
    assert found.keys() == STATUS
    assert (found["scenes"], found["done"], found["missing"], found["failed"]) == (7, 4, 3, 0)
    assert (found["running"], found["scenes_per_hour"], found["seconds_left"]) == ([], None, None)
    assert "7 scenes: 4 done" in done.stderr


def test_the_status_of_some_scenes_counts_only_those(three_missing):
    with claimed(three_missing / "renders", "000004"):
        for scene_id, running in (("000004", ["000004"]), ("000005", [])):
            done = night_here("night-render", "status", three_missing, "--only", scene_id, "--json")
            assert result(done)["running"] == running


def test_a_verification_as_json_keeps_its_exit_code(rendered_copy):
    (rendered_copy / "renders" / "000002" / "itof.exr").write_bytes(b"damaged")
    shutil.rmtree(rendered_copy / "renders" / "000003")
    done = night_here("night-render", "verify", rendered_copy, "--json")
    assert done.returncode == 1
    found = result(done)
    assert found.keys() == VERIFICATION
    assert (found["good"], found["bad"], found["not_rendered"], found["not_checked"]) == (5, 1, 1, 0)
    assert list(found["problems"]) == ["000002"]


@pytest.mark.parametrize("words", [(), ("--dry-run",)])
def test_a_refusal_prints_no_object(seven_renders, words):
    assert "rendered with other settings" in refusal(
        "night-render", seven_renders, *words, "--resolution", "12x9", "--json"
    )


def test_the_keys_are_documented():
    page = (ROOT / "docs" / "reference" / "files.md").read_text()
    section = page[page.index("## Results as JSON") :]
    named = set(re.findall(r"`(\w+)`", section))
    assert set() == (RUN | SETTING | PLAN | STATUS | VERIFICATION) - named
