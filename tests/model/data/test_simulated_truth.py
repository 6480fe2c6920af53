"""Ground truth from the simulator's transient of the mirrored scene."""

import numpy as np
import pytest
from exported_scene import WIDTH
from night_commands import refusal
from synthetic_dataset import write_synthetic_dataset
from training_runs import FLIP, config_of, settings

from itof import ImageFileError, TransientLayout, TransientWriter, phasor_of_return
from model.data.renders import ShardError, read_render
from model.data.shards import open_shards
from model.judging.evaluation import evaluate
from model.run_folder.run_config import RunError
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")
BIN_M = 0.05
COURSE = FLIP | {"ground_truth": "simulated", "max_epochs": 1}


@pytest.fixture
def dataset(tmp_path):
    """Closed-form scenes with mirrored transients: a pixel's light is in the bin nearest to its depth."""
    made = write_synthetic_dataset(tmp_path / "data", count=8)
    for scene in made.ids():
        write_transient(made, scene)
    return made


def write_transient(dataset, scene, change=lambda bins: bins):
    depth_m = read_render(dataset, scene).truth.radial_depth_m
    height, width = depth_m.shape
    layout = TransientLayout(width, height, 160, BIN_M, 1.0)
    bins = np.zeros((height, width, 160), np.float32)
    rows, columns = np.nonzero(depth_m)
    # Any strength: the truth must not depend on it.
    bins[rows, columns, nearest(depth_m)[rows, columns]] = 1e-3 * (1 + rows + columns)
    with TransientWriter(dataset.render_folder(scene) / "mirrored_transient.exr", layout, {}) as writer:
        writer.write_rows(change(bins))


def nearest(depth_m):
    """Index of the bin that is nearest to a depth; bins begin at 1 m of optical path."""
    return np.maximum(np.round((2 * depth_m - 1.0) / BIN_M - 0.5), 0).astype(int)


def test_the_truth_of_the_simulator_is_a_phasor_of_amplitude_1_with_the_depth_of_its_light(dataset):
    geometry, simulated = (open_shards(dataset, ground_truth=truth) for truth in ("geometry", "simulated"))
    rows = simulated.rows("train")
    shape, light = geometry.read(rows), simulated.read(rows)
    assert shape.mask.any()
    np.testing.assert_array_equal(light.mask, shape.mask)
    np.testing.assert_array_equal(light.phasors, shape.phasors)
    seen = shape.mask > 0
    centre_m = (1.0 + (nearest(shape.radial_depth_m) + 0.5) * BIN_M) / 2
    np.testing.assert_allclose(light.radial_depth_m[seen], centre_m[seen], rtol=1e-6)  # float32
    assert not light.radial_depth_m[~seen].any()
    expected = seen * phasor_of_return(centre_m, 20e6)
    np.testing.assert_allclose(light.target, expected, atol=1e-6)
    assert (light.radial_depth_m != shape.radial_depth_m).any()  # by up to a quarter of a bin


def test_both_truths_have_shards_of_their_own_and_neither_is_built_again(dataset, caplog):
    open_shards(dataset)
    files = {file: file.read_bytes() for file in dataset.shard_folder.rglob("*.*")}
    open_shards(dataset, ground_truth="simulated")
    caplog.set_level("INFO")
    for truth in ("geometry", "simulated"):
        open_shards(dataset, ground_truth=truth)
    assert "building" not in caplog.text
    assert {file: file.read_bytes() for file in files} == files
    write_transient(dataset, "000000", lambda bins: np.roll(bins, 1, axis=2))
    open_shards(dataset)
    assert "building" not in caplog.text
    open_shards(dataset, ground_truth="simulated")
    assert "1 render changed, first renders/000000/mirrored_transient.exr" in caplog.text


@pytest.mark.long
def test_a_training_by_the_simulated_truth_learns_another_truth_and_is_resumed_by_it(dataset, tmp_path):
    for truth in ("simulated", "geometry"):
        train(dataset, tmp_path / truth, settings(**COURSE | {"ground_truth": truth}))
    losses = [(tmp_path / run / "history.csv").read_bytes() for run in ("simulated", "geometry")]
    assert losses[0] != losses[1]
    config = config_of(tmp_path / "simulated")
    assert config["settings"]["run"]["ground_truth"] == "simulated"
    assert config["data_sha256"] != config_of(tmp_path / "geometry")["data_sha256"]
    train(dataset, tmp_path / "simulated", settings(**COURSE | {"max_epochs": 2}), resume=True)
    report = evaluate(tmp_path / "simulated", dataset, tmp_path / "report", device="cpu", progress=False)
    assert len(report.scenes) == len(dataset.ids("test"))
    assert "the ground truth of the training was the simulated one" in (
        (tmp_path / "report" / "index.html").read_text()
    )
    with pytest.raises(RunError, match=r"run\.ground_truth was simulated and is now geometry"):
        train(dataset, tmp_path / "simulated", settings(max_epochs=3, **FLIP), resume=True)


def test_renders_without_transients_or_with_impossible_ones_are_refused_in_one_sentence(
    dataset, closed_form_scenes, tmp_path
):
    said = refusal(
        *("night-train", closed_form_scenes.root, "--out", tmp_path / "run"),
        *("--set", "run.ground_truth=simulated"),
    )
    assert "scene 000000 (and 11 more of 12 scenes) has no mirrored_transient.exr: run night-render" in said
    assert said.endswith("--product both")
    write_transient(dataset, "000001", lambda bins: bins * np.float32(np.nan))
    with pytest.raises(
        ShardError, match=r"scene 000001: .*mirrored_transient.exr holds \d+ values that are NaN"
    ):
        open_shards(dataset, ground_truth="simulated")
    file = dataset.render_folder("000001") / "mirrored_transient.exr"
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(ImageFileError, match=r"mirrored_transient.exr .*: delete it and render it again$"):
        open_shards(dataset, ground_truth="simulated")


def test_the_simulator_and_the_shape_agree_inside_a_rendered_object(transient_dataset):
    shape, light = (
        read_render(transient_dataset, "000000", truth).truth for truth in ("geometry", "simulated")
    )
    assert np.abs(light.phasor[light.mask]) == pytest.approx(1, abs=1e-6)
    # Every pixel whose centre shows the object gets light; others do at the edge only.
    grown, inner = shape.mask.copy(), shape.mask.copy()
    for axis, by in ((0, 1), (0, -1), (1, 1), (1, -1)):
        grown |= np.roll(grown, by, axis)
        inner &= np.roll(shape.mask, by, axis)
    assert inner.any()
    assert (shape.mask <= light.mask).all()
    assert (light.mask <= grown).all()
    # As in tests/render/test_render.py for a sphere of radius 0.28 m: (d p)^2 / (2 r cos^3 45 degrees).
    pixel_m = shape.radial_depth_m.max() * 2 * np.tan(np.radians(30)) / WIDTH
    bound_m = pixel_m**2 / (2 * 0.28 * np.cos(np.radians(45)) ** 3)
    np.testing.assert_allclose(light.radial_depth_m[inner], shape.radial_depth_m[inner], atol=bound_m)
