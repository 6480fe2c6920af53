"""Networks learn from the measurement: with every setting, and to a stated accuracy."""

import csv
import json

import numpy as np
import pytest
import torch
from night_commands import FIGURES
from synthetic_dataset import write_synthetic_dataset
from training_runs import FLIP, settings

from itof import phasor_of_return
from itof.metrics import image_metrics
from model.data.shards import open_shards
from model.judging.evaluation import evaluate
from model.network.readout import Readout
from model.paper.loss import NightLoss
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")


def best_constant_loss(dataset, loss) -> float:
    """Loss on the training scenes of the best output that is the same in all pixels of all scenes."""
    shards = open_shards(dataset)
    block = shards.read(shards.rows("train"))
    target = np.stack([block.target.real, block.target.imag], axis=1)  # (N, 2, H, W)
    truth = [torch.from_numpy(array) for array in (target, block.radial_depth_m, block.mask)]
    outputs = [
        torch.tensor([z.real, z.imag], dtype=torch.float32)[:, None, None].expand(truth[0].shape)
        for amplitude in np.linspace(0, 1, 11)
        for z in amplitude * phasor_of_return(np.linspace(0, 7.4, 38), 20e6)
    ]
    return min(float(loss(output, *truth)) for output in outputs)


@pytest.mark.long
@pytest.mark.parametrize(
    "change",
    [
        {"loss_on": "depth"},
        {"loss": "mse+iou"},
        {"channels": "paper"},
        {"channels": "residual"},
        {"flip_rows": False},
        {"frequencies_hz": (50e6,)},
        {"precision": "bfloat16"},
        {"precision": "float16"},
        {"optimiser": "muon"},
        {"ema_decay": 0.5, "clip_norm": 1.0, "schedule": "cosine", "warm_up_epochs": 1.0},
    ],
)
def test_every_choice_learns_on_closed_form_scenes(closed_form_scenes, tmp_path, change):
    learning = {"width": 4, "batch_size": 2, "max_epochs": 6, "learning_rate": 2e-3} | FLIP
    chosen = settings(**(learning | change))
    train(closed_form_scenes, tmp_path / "run", chosen)
    with (tmp_path / "run" / "history.csv").open() as stream:
        losses = [float(line["train_loss"]) for line in csv.DictReader(stream)]
    loss = NightLoss(Readout(20e6), chosen.target.loss, chosen.target.loss_on)
    assert losses[-1] < best_constant_loss(closed_form_scenes, loss)


@pytest.fixture(scope="module")
def many_scenes(tmp_path_factory):
    """160 scenes: the truth is a disc at a known point, the measurement a closed form of that point."""
    tables = {"count": 160, "test_fraction": 0.2, "validation_fraction": 0.2}
    return write_synthetic_dataset(tmp_path_factory.mktemp("many"), count=160, dataset=tables)


@pytest.fixture(scope="module")
def judged(many_scenes, tmp_path_factory):
    """The report of a small network that was trained on these scenes, and its folder."""
    root = tmp_path_factory.mktemp("judged")
    learning = {"width": 8, "batch_size": 8, "max_epochs": 20, "learning_rate": 3e-3, "alpha": 1.0}
    course = {"schedule": "cosine", "warm_up_epochs": 1.0, "clip_norm": 1.0}
    result = train(many_scenes, root / "run", settings(**learning, **course, **FLIP))
    assert result.epochs == 20
    report = evaluate(root / "run", many_scenes, root / "report", device="cpu", progress=False)
    return report, root / "report"


@pytest.mark.long
def test_a_small_network_finds_a_disc_of_known_place_to_within_two_pixels(judged, many_scenes):
    prediction = judged[0].prediction
    shards = open_shards(many_scenes)
    truth = shards.read(shards.rows("test"))
    depth_m, mask = truth.radial_depth_m, truth.mask > 0

    def score(depths_m, masks):
        each = [image_metrics(*images) for images in zip(depths_m, masks, depth_m, mask, strict=True)]
        return np.mean([(metrics.depth_mae_m, metrics.miou) for metrics in each], axis=0)

    # No prediction that is the same for all scenes has a smaller error than the median of each pixel.
    same_m = np.broadcast_to(np.median(depth_m, axis=0), depth_m.shape)
    assert prediction.depth_mae_m.mean < score(same_m, same_m > 0)[0]
    moved = [
        score(np.roll(depth_m, step, axis), np.roll(mask, step, axis)) for step in (2, -2) for axis in (1, 2)
    ]
    assert prediction.miou.mean > max(miou for _, miou in moved)


@pytest.mark.long
def test_training_and_evaluation_end_to_end_beat_no_object(judged, many_scenes):
    report, folder = judged
    assert len(report.scenes) == len(many_scenes.ids("test"))
    # Better masks than no object, by three standard errors of the mean.
    gain = np.array([scene.prediction.miou - scene.no_object.miou for scene in report.scenes])
    assert gain.mean() > 3 * gain.std(ddof=1) / np.sqrt(len(gain))
    written = json.loads((folder / "metrics.json").read_text())
    assert written["prediction"]["miou"]["mean"] == report.prediction.miou.mean
    assert written["paper"]["depth_mae_m"]["mean"] == 0.0521
    assert [scene["scene"] for scene in written["scenes"]] == many_scenes.ids("test")
    assert {file.stem for file in (folder / "figures").iterdir()} == FIGURES
    assert "no object" in report.table
    assert (folder / "table.txt").read_text() == report.table + "\n"
