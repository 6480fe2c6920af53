"""Trainings on scenes that worker processes render meanwhile."""

import os
import signal
from dataclasses import replace

import numpy as np
import psutil
import pytest
import torch
from night_commands import night_here
from training_runs import FLIP, checkpoint, preset_text, settings

from model.run_folder.run_config import RunError
from model.settings.fresh import FreshScenes
from model.training.fresh.feed import FreshFeed
from model.training.fresh.workers import FreshError, FreshWorkers, Rendering
from model.training.loop import train
from model.training.processes import Processes
from model.training.refusals import TrainingError
from scenegen import preset_from_dict

WIDTH, HEIGHT = 24, 14
TABLES = {"camera": {"width": WIDTH, "height": HEIGHT}}  # of the closed-form scenes
FEW = FLIP | {"width": 2, "batch_size": 4, "epoch_scenes": 10, "max_epochs": 2}

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def preset():
    return preset_from_dict(TABLES, "a test")


@pytest.fixture(scope="module")
def rendering(preset):
    return Rendering(FreshScenes(preset).with_seed(5), {}, WIDTH, HEIGHT, 0.1, "cpu", 1)


@pytest.fixture(scope="module")
def worker(rendering):
    """One worker, which takes seconds to start."""
    alone = FreshWorkers(rendering, 1)
    yield alone
    alone.close()


def lists(count, size=3):
    return iter([list(range(start, start + size)) for start in range(0, count * size, size)])


def test_scenes_come_in_order_with_the_same_bits_from_one_worker_or_two(worker, rendering):
    pair = FreshWorkers(rendering, 2)
    one, two = (list(workers.results(lists(4))) for workers in (worker, pair))
    pair.close()
    assert [block.rows for block in one] == [(0, 1, 2), (3, 4, 5), (6, 7, 8), (9, 10, 11)]
    for block, other in zip(one, two, strict=True):
        assert block.rows == other.rows
        for name in ("phasors", "target", "radial_depth_m", "mask"):
            assert np.array_equal(getattr(block, name), getattr(other, name))
    assert len({block.phasors.tobytes() for block in one}) == 4


def test_a_stream_is_that_of_its_seed_and_of_no_dataset(preset):
    scenes = FreshScenes(preset)
    first, same, other = (scenes.with_seed(seed).scene(0, {}) for seed in (1, 1, 2))
    assert first == same
    assert first.hidden_objects != other.hidden_objects
    assert first.hidden_objects != scenes.scene(0, {}).hidden_objects


def test_a_killed_worker_is_replaced_and_no_scene_is_lost(worker):
    results = worker.results(lists(5))
    first = next(results)
    for child in psutil.Process().children(recursive=True):
        if "spawn_main" in " ".join(child.cmdline()):
            os.kill(child.pid, signal.SIGKILL)
    assert [first.rows, *(block.rows for block in results)] == [
        tuple(range(start, start + 3)) for start in range(0, 15, 3)
    ]


def test_a_corner_without_light_is_named_once(preset):
    away = replace(preset, camera=replace(preset.camera, rotation_deg=(90.0, 0.0, 230.0)))
    rendering = Rendering(FreshScenes(away).with_seed(5), {}, WIDTH, HEIGHT, 0.1, "cpu", 1)
    with pytest.raises(FreshError, match="the preset's corner lets no light through"):
        rendering.rows(rendering.light(), [0, 1])


def test_a_feed_goes_on_at_any_batch_and_gives_each_process_its_part(worker):
    def batches(skip, processes, epoch=1):
        feed = FreshFeed(worker, 10, 2, WIDTH * HEIGHT, lambda block: block, processes)
        _, found = feed.epoch(epoch, torch.Generator(), 4, skip)
        return list(found)

    whole = batches(0, Processes(torch.device("cpu")))
    assert [list(batch.rows) for batch in whole] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    later = batches(2, Processes(torch.device("cpu")))
    assert [list(batch.rows) for batch in later] == [[8, 9]]
    part = batches(0, Processes(torch.device("cpu"), rank=1, count=2))
    assert [list(batch.rows) for batch in part] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    for all_rows, own in zip(whole, part, strict=True):
        mine = list(all_rows.rows)[1::2]
        assert np.array_equal(own.take(mine).phasors, all_rows.take(mine).phasors)
        assert all(row % 2 == list(all_rows.rows)[1] % 2 for row in own.own.rows)
    second = batches(0, Processes(torch.device("cpu")), epoch=2)
    assert [row for batch in second for row in batch.rows] == list(range(10, 20))


@pytest.mark.long
def test_an_interrupted_training_ends_with_the_same_weights(closed_form_scenes, preset, tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    train(closed_form_scenes, whole, settings(**FEW), fresh=preset)

    class StopError(Exception):
        pass

    def stop_after(batches):
        from model.training import epoch

        done = []
        original = epoch.save_if_due

        def save_then_stop(state, out, interruption, watch=None):
            done.append(None)
            if len(done) == batches:
                state.save(out)
                raise StopError
            original(state, out, interruption, watch)

        return save_then_stop

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("model.training.epoch.save_if_due", stop_after(2))
        patch.setattr("model.training.epoch._check_every", lambda state: 1)
        with pytest.raises(StopError):
            train(closed_form_scenes, broken, settings(**FEW), fresh=preset)
    other = preset_from_dict(TABLES | {"relay_wall": {"reflectance": 0.5}}, "another")
    with pytest.raises(RunError, match="on other scenes than those of --fresh"):
        train(closed_form_scenes, broken, settings(**FEW), resume=True, fresh=other)
    train(closed_form_scenes, broken, settings(**FEW), resume=True, fresh=preset)
    expected, found = (checkpoint(run)["network"] for run in (whole, broken))
    assert all(torch.equal(expected[name], found[name]) for name in expected)


@pytest.mark.parametrize(
    ("tables", "changes", "reason"),
    [
        ({"itof": {"frequencies_hz": [20e6, 40e6]}}, {}, "fresh scenes have 20, 40 MHz"),
        ({"camera": {"width": 20, "height": 20}}, {}, "fresh ones have the shape 20x20"),
        ({"transient": {"max_bounces": 4}}, {}, "fresh scenes have 3 bounces"),
        ({"camera_spread": {"location_m": 0.1}}, {}, "have their cameras elsewhere"),
        ({"relay_wall": {"location_m": [0.1, 0, 2]}}, {}, "camera and relay wall of fresh scenes"),
        ({"hidden_object": {"shapes": ["cube", "mesh:own.ply"]}}, {}, "give --fresh PRESET"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_training(
    closed_form_scenes, tmp_path, tables, changes, reason
):
    fresh = preset_from_dict(TABLES | tables, "a test")
    with pytest.raises(TrainingError, match=reason):
        train(closed_form_scenes, tmp_path / "run", settings(**FEW | changes), fresh=fresh)
    assert not (tmp_path / "run" / "run.json").exists()


def test_the_command_trains_on_fresh_scenes(closed_form_scenes, tmp_path):
    scenes, chosen = tmp_path / "corner.toml", tmp_path / "settings.toml"
    scenes.write_text(f"[camera]\nwidth = {WIDTH}\nheight = {HEIGHT}\n")
    chosen.write_text(preset_text(settings(**FEW | {"max_epochs": 1})))
    run = tmp_path / "run"
    done = night_here(
        *("night-train", closed_form_scenes.root, "--fresh", scenes, "--out", run, "--preset", chosen)
    )
    assert done.returncode == 0, done.stderr
    assert "1 epoch, ended by max_epochs" in done.stdout
    assert (run / "best.safetensors").is_file()
