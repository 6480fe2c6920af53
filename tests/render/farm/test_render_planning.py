"""Plans, claims and status: what is said before and during a run is what the disk shows."""

import fcntl
import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace

import pytest

from render.farm.claims import OtherRunError, attempts_of, claimed, joined_run, refuse_other_run, running
from render.farm.inventory import Inventory
from render.farm.plan import make_plan, size
from render.farm.rendering_record import record_rendering
from render.farm.status import duration, read_status
from render.options import ManyLightOptions, PathOptions
from render.settings import RenderError, RenderSettings, settings_for, settings_of
from scenegen import RECORD_FILE, RenderingRecord, open_dataset, read_recipe, read_record, write_record

SETTINGS = RenderSettings(product="both", options=ManyLightOptions(error=0.05))  # of the shared renders


@pytest.fixture(scope="module")
def dataset(make_dataset):
    return make_dataset({"dataset": {"count": 7}, "camera": {"width": 64, "height": 48}})


@pytest.fixture
def rendered(rendered_copy):
    """Seven scenes, the first three rendered."""
    for scene_id in ("000003", "000004", "000005", "000006"):
        shutil.rmtree(rendered_copy / "renders" / scene_id)
    return open_dataset(rendered_copy)


def test_an_estimate_is_about_what_scenes_turn_out_to_take(rendered):
    blind = make_plan(rendered, SETTINGS, rendered.ids(), [])
    informed = make_plan(rendered, SETTINGS, rendered.ids(), rendered.ids()[:3])
    records = [read_record(rendered.render_folder(scene)) for scene in rendered.ids()[:3]]
    measured = sum(file.bytes for record in records for file in record.files.values()) / 3
    assert informed.scene_bytes == pytest.approx(measured, abs=1)  # whole bytes
    # Small images compress worse or better than large ones; a plan must not be off by a factor.
    assert 0.5 < blind.scene_bytes / measured < 2.5


def test_a_plan_that_does_not_fit_says_what_would(dataset):
    plan = make_plan(dataset, RenderSettings(product="both"), dataset.ids(), [])
    assert plan.refusal() is None
    tight = replace(plan, free_bytes=plan.needed_bytes // 5)
    refusal = tight.refusal()
    assert "--product itof needs" in refusal
    assert "--resolution 16x12 fits" in refusal  # a 16th of the pixels; a quarter of them is too many
    assert "there is room for 1 scene" in refusal
    small = replace(tight, settings=RenderSettings(product="itof"))
    assert small.refusal() is None


@pytest.mark.parametrize(("bounces", "hidden"), [(1, False), (2, False), (3, True), (6, True)])
def test_a_plan_warns_of_renders_without_hidden_light(dataset, bounces, hidden):
    plan = make_plan(dataset, RenderSettings(max_bounces=bounces), dataset.ids(), [])
    assert any("no light of the hidden object" in line for line in plan.sentences()) is not hidden


@pytest.mark.parametrize(
    ("count", "words"),
    [(0, "0 bytes"), (999, "999 bytes"), (5_500_000, "5.5 MB"), (123e9, "123 GB"), (4.2e15, "4200 TB")],
)
def test_sizes_read_as_people_write_them(count, words):
    assert size(count) == words


@pytest.mark.parametrize(
    ("seconds", "words"), [(5, "5 s"), (600, "10 min"), (7200, "2.0 h"), (1e6, "11.6 days")]
)
def test_spans_of_time_read_as_people_say_them(seconds, words):
    assert duration(seconds) == words


def test_settings_survive_the_way_through_rendering_json(dataset):
    given = RenderSettings(product="both", options=PathOptions(spp=7), resolution=(32, 24))
    record = RenderingRecord(
        method=given.method,
        product=given.product,
        max_bounces=given.bounces(dataset),
        options=asdict(given.options),
        width=32,
        height=24,
        packages={},
        scene_count=0,
        hidden_error_median=None,
        hidden_error_max=None,
    )
    assert settings_of(record, dataset) == given


@pytest.mark.parametrize("bounces", [0, -1, 65])
def test_bounces_that_cannot_be_rendered_are_refused(bounces):
    with pytest.raises(RenderError, match="between 1 and 64 bounces are rendered"):
        RenderSettings(max_bounces=bounces)


def test_points_are_given_or_chosen_for_an_error_not_both(dataset):
    assert settings_for(dataset, {"lights": 64}).options == ManyLightOptions(lights=64)
    assert settings_for(dataset, {"error": 0.05}).options == ManyLightOptions(error=0.05)
    with pytest.raises(RenderError, match="leave one out"):
        settings_for(dataset, {"lights": 64, "error": 0.05})


def test_a_claim_counts_attempts_of_one_run_and_forgets_those_of_another(tmp_path):
    with claimed(tmp_path, "000001") as claim:
        assert [claim.begin("first"), claim.begin("first")] == [1, 2]
    assert attempts_of(tmp_path, "000001", "first") == 2
    assert attempts_of(tmp_path, "000001", "second") == 0
    with claimed(tmp_path, "000001") as claim:
        assert claim.begin("second") == 1
        claim.forget()
    assert attempts_of(tmp_path, "000001", "second") == 0
    assert running(tmp_path) == []


def test_a_claim_is_one_process_s_and_dies_with_it(tmp_path):
    code = (
        "import sys, time, pathlib; from render.farm.claims import claimed\n"
        "with claimed(pathlib.Path(sys.argv[1]), '000007') as claim:\n"
        "    print(claim is not None, flush=True); time.sleep(600)"
    )
    holder = subprocess.Popen([sys.executable, "-c", code, tmp_path], stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "True\n"
    assert running(tmp_path) == ["000007"]
    with claimed(tmp_path, "000007") as claim:
        assert claim is None
    holder.kill()
    holder.communicate()
    assert running(tmp_path) == []
    with claimed(tmp_path, "000007") as claim:
        assert claim is not None


@pytest.mark.parametrize("damage", [b"[" * 4096, b'{"a": Infinity}', b"\xff", b"[1]"])
def test_a_damaged_claim_counts_no_attempts(tmp_path, damage):
    (tmp_path / ".claims").mkdir()
    (tmp_path / ".claims" / "000001").write_bytes(damage)
    assert attempts_of(tmp_path, "000001", "a") == 0
    with claimed(tmp_path, "000001") as claim:
        assert claim.begin("a") == 1


@pytest.mark.parametrize("forged", ["0.00x", "nan", "-1", "inf", ""])
def test_a_forged_error_of_a_render_is_no_error(rendered, forged):
    scene_id = rendered.ids()[0]
    record = read_record(rendered.render_folder(scene_id))
    attributes = {**record.attributes, "hidden_error": forged}
    write_record(rendered.render_folder(scene_id), replace(record, attributes=attributes))
    deep = read_record(rendered.render_folder(rendered.ids()[1]))
    write_record(rendered.render_folder(rendered.ids()[1]), replace(deep, recipe="[" * 100_000))
    record_rendering(rendered, SETTINGS, True, finished=True)
    assert 0 < rendered.rendering.hidden_error_max < 0.06  # of the third scene
    assert read_recipe("[" * 100_000) == {}


def test_runs_of_the_same_settings_go_together_and_others_wait(tmp_path):
    renders = tmp_path / "renders"
    with (
        joined_run(renders, "one"),
        joined_run(renders, "one"),
        pytest.raises(OtherRunError, match="with other settings"),
        joined_run(renders, "two"),
    ):
        pytest.fail("two kinds of settings at once")
    with joined_run(renders, "two"):
        pass


def test_a_plan_writes_nothing_and_says_that_others_render_otherwise(tmp_path):
    renders = tmp_path / "renders"
    refuse_other_run(renders, "one")
    assert not renders.exists()
    with joined_run(renders, "one"):
        refuse_other_run(renders, "one")
        with pytest.raises(OtherRunError, match="with other settings \\(one\\)"):
            refuse_other_run(renders, "two")
    refuse_other_run(renders, "two")
    assert (renders / ".run").read_text() == "one"


def test_a_run_that_starts_while_a_plan_looks_is_not_refused(tmp_path):
    renders = tmp_path / "renders"
    with joined_run(renders, "one"):
        pass
    with (renders / ".run").open() as plan:
        fcntl.flock(plan, fcntl.LOCK_EX)
        look = threading.Timer(0.2, lambda: fcntl.flock(plan, fcntl.LOCK_UN))
        look.start()
        with joined_run(renders, "two"):
            assert (renders / ".run").read_text() == "two"
        look.join()


def test_the_pace_is_that_of_the_latest_scenes_without_the_pause_before(rendered, monkeypatch):
    now = time.time()
    monkeypatch.setattr("render.farm.status.time.time", lambda: now)
    for scene_id, age_s in zip(rendered.ids(), (9000, 20, 10), strict=False):
        os.utime(rendered.render_folder(scene_id) / RECORD_FILE, (now - age_s, now - age_s))
    # Nothing is being rendered.
    assert read_status(rendered, SETTINGS, rendered.ids()).scenes_per_hour is None
    with claimed(rendered.root / "renders", "000003"):
        status = read_status(rendered, SETTINGS, rendered.ids())
    assert status.running == ["000003"]
    # One scene in the 20 s since the first of the two was done; times of files are floats of 2e-7 s.
    assert status.scenes_per_hour == pytest.approx(3600 / 20, rel=1e-6)
    assert status.sentences()[0] == "7 scenes: 3 done, 1 running, 0 failed, 3 missing"


def test_a_smaller_product_is_contained_in_a_larger_one(rendered):
    states = {
        product: Inventory(rendered, replace(SETTINGS, product=product)).state("000000")
        for product in ("itof", "transient", "both")
    }
    assert set(states.values()) == {"done"}
