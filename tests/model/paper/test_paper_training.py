"""The preset `paper` trains as text and released code say; what it fits to the data stays with the run."""

import json

import numpy as np
import pytest
import torch
from synthetic_dataset import edit_image, write_synthetic_dataset
from training_runs import as_tables, assert_same_end, config_of, edit_config, edit_settings, settings

from itof.metrics import image_metrics
from model.data.shards import open_shards
from model.judging.evaluation import EvaluationError, evaluate
from model.prediction.predictor import load
from model.run_folder.run_config import RunError, read_config
from model.settings.keys import merged
from model.settings.presets import training_preset
from model.settings.train_settings import TrainSettings, flat_settings, settings_from_dict
from model.training.loop import train
from model.training.refusals import TrainingError

pytestmark = pytest.mark.usefixtures("one_thread")
SMALL = {"width": 2, "batch_size": 3, "learning_rate": 1e-3, "device": "cpu", "progress": False}
FEW_COPIES = {"copies_per_change": 1}  # as there are few scenes


def paper(**changes) -> TrainSettings:
    return settings_from_dict(
        merged(training_preset("paper")[0], as_tables(**(SMALL | FEW_COPIES | changes))), "paper"
    )


@pytest.fixture(scope="module")
def paper_run(closed_form_scenes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper") / "run"
    train(closed_form_scenes, folder, paper(max_epochs=2))
    return folder


def test_the_preset_of_the_paper_has_the_numbers_of_text_and_released_code():
    chosen = flat_settings(settings_from_dict(training_preset("paper")[0], "paper"))
    numbers = {
        "input.channels.kind": "paper",
        "input.channels.amplitude_divisor": "maximum",
        "network.width": 32,
        "network.levels": 5,
        "network.negative_slope": 0,
        "network.block": 1,
        "target.kind": "components",
        "target.loss": "mae+iou",
        "target.loss_on": "components",
        "target.balance": "dataset",
        "target.alpha": 1 / 7,
        "target.mask_from": "depth",
        "target.dead_zone": 0.05,
        "optimiser.algorithm": "adam",
        "optimiser.learning_rate": 1e-4,
        "optimiser.batch_size": 32,
        "optimiser.schedule": "constant",
        "optimiser.warm_up_epochs": 0,
        "augmentation.flip_rows": True,
        "augmentation.noise_sigma": 0,
        "augmentation.paper.flip_columns": True,
        "augmentation.paper.rotation_deg": 180,
        "augmentation.paper.translation": 0.2,
        "augmentation.paper.channel_noise_sigma": 1,
        "augmentation.paper.copies_per_change": 403,
        "run.max_epochs": 1500,
        "run.patience": 150,
        "run.min_delta": 0.015,
    }
    assert {key: chosen[key] for key in numbers} == numbers


def test_the_run_records_the_ratio_and_the_amplitude_of_its_training_scenes(paper_run, shards):
    block = shards.read(shards.rows("train"))
    truth = block.mask > 0
    amplitude = np.abs(block.phasors[..., 0])
    config = read_config(paper_run)
    assert config.background_per_object == (~truth).sum() / truth.sum()
    everything = (
        shards.read([*shards.rows("train"), *shards.rows("validation"), *shards.rows("test")]).mask > 0
    )
    assert config.background_per_object != (~everything).sum() / everything.sum()
    assert config.inputs.amplitude_scale == pytest.approx(amplitude.max(), rel=1e-6)
    assert config.inputs.mean_amplitude == pytest.approx(amplitude.mean(), rel=1e-6)


def test_a_resumed_run_keeps_the_recorded_ratio_and_ends_as_if_uninterrupted(
    closed_form_scenes, paper_run, tmp_path
):
    run = tmp_path / "run"
    train(closed_form_scenes, run, paper(max_epochs=1))
    train(closed_form_scenes, run, paper(max_epochs=2), resume=True)
    assert_same_end(run, paper_run)
    assert read_config(run).background_per_object == read_config(paper_run).background_per_object
    edit_config(run, background_per_object=7.0)  # what is recorded decides, not what could be counted again
    train(closed_form_scenes, run, paper(max_epochs=3), resume=True)
    assert read_config(run).background_per_object == 7.0
    whole = tmp_path / "whole"
    train(closed_form_scenes, whole, paper(max_epochs=3))
    losses = [(folder / "history.csv").read_text().splitlines()[-1].split(",")[2] for folder in (run, whole)]
    assert losses[0] != losses[1]
    with pytest.raises(RunError, match=r"target\.balance was dataset and is now image"):
        train(closed_form_scenes, run, paper(max_epochs=3, balance="image"), resume=True)
    other = tmp_path / "other"
    train(closed_form_scenes, other, settings(max_epochs=1))
    with pytest.raises(RunError, match=r"target\.balance was image and is now dataset"):
        train(closed_form_scenes, other, settings(max_epochs=1, balance="dataset"), resume=True)


def test_a_run_that_lost_its_ratio_is_refused(paper_run, tmp_path, closed_form_scenes):
    run = tmp_path / "run"
    train(closed_form_scenes, run, settings(max_epochs=1))
    assert "background_per_object" not in config_of(run)  # runs that need no ratio are written as before
    edit_settings(run, balance="dataset")
    with pytest.raises(RunError, match="needs background_per_object"):
        read_config(run)


@pytest.mark.parametrize(("value", "seen"), [(0.0, "no object"), (1.0, "no background")])
def test_training_scenes_of_one_class_alone_are_refused_in_one_sentence(tmp_path, value, seen):
    dataset = write_synthetic_dataset(tmp_path / "data", count=4)
    for scene in dataset.ids("train"):
        edit_image(
            dataset.render_folder(scene) / "mirrored.exr",
            mask_M=lambda mask: np.full_like(mask, value),
            depth_R=lambda depth: np.full_like(depth, 3 * value),
        )
    with pytest.raises(TrainingError, match=f"shows {seen}: train with target.balance image"):
        train(dataset, tmp_path / "run", paper(max_epochs=1))


@pytest.mark.long
def test_a_run_can_be_judged_by_masks_of_the_depth_and_of_the_amplitude(
    paper_run, closed_form_scenes, tmp_path
):
    shards = open_shards(closed_form_scenes)
    block = shards.read(shards.rows("test"))
    output = load(paper_run, "cpu").predict(block.phasors, shards.reference).phasor
    phase = np.angle(output) % (2 * np.pi)
    everywhere_m = phase * load(paper_run, "cpu").config.readout.metres_per_radian
    masks = {"depth": everywhere_m > 0, "amplitude": np.abs(output) >= 0.5}
    assert (masks["depth"] != masks["amplitude"]).any()
    judged = {}
    for source, mask in masks.items():
        out = tmp_path / source
        chosen = {} if source == "depth" else {"mask_from": source}
        report = evaluate(paper_run, closed_form_scenes, out, device="cpu", progress=False, **chosen)
        images = zip(everywhere_m * mask, mask, block.radial_depth_m, block.mask, strict=True)
        expected = [image_metrics(*image) for image in images]
        assert [r.prediction.miou for r in report.scenes] == [m.miou for m in expected]
        found_m = [r.prediction.depth_mae_m for r in report.scenes]
        assert found_m == pytest.approx([m.depth_mae_m for m in expected], rel=1e-5)
        written = json.loads((out / "metrics.json").read_text())
        assert (written["mask_from"], written["run_mask_from"]) == (source, "depth")
        assert written["mask_threshold"] == (None if source == "depth" else 0.5)
        judged[source] = report
    assert judged["depth"].calibration.judged_with == "judged with depth above 0 m (the run's own)"
    assert "judged with mask threshold 0.5 (the run's own is depth above 0 m)" in judged["amplitude"].table
    assert judged["depth"].calibration.judged == judged["amplitude"].calibration.judged
    with pytest.raises(EvaluationError, match="add --mask-from amplitude"):
        evaluate(paper_run, closed_form_scenes, tmp_path / "no", progress=False, mask_threshold=0.7)
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("change", [{"balance": "class-means"}, {"loss": "mae+lovasz"}, {"loss_on": "depth"}])
def test_every_new_choice_of_the_loss_trains(closed_form_scenes, tmp_path, change):
    result = train(closed_form_scenes, tmp_path / "run", paper(max_epochs=1, **change))
    assert np.isfinite(result.best_validation_loss)
    weights = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["network"]
    assert all(weight.isfinite().all() for weight in weights.values())
