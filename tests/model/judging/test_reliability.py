"""Reliability of probabilities and of expected errors: closed forms, and in the report."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from training_runs import train_on_one_thread

from itof import DepthMap, phasor_of_return
from itof.metrics import image_metrics
from model.judging.evaluation import evaluate
from model.judging.reliability import DepthReliabilityCount, Reliability, ReliabilityCount
from model.judging.report.charts import depth_error_charts, uncertainty_charts
from model.prediction.expected_error import expected_mae_m
from model.prediction.predictor import load

FREQUENCY_HZ = 20e6
DOUBTING = {"target": "mask+depth", "uncertainty": True, "mask_threshold": 0.1}
DOUBTING |= {"width": 4, "batch_size": 4, "max_epochs": 2}

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def doubting(closed_form_scenes, tmp_path_factory):
    """A run that predicts probabilities and errors, a report of its training scenes, and its folder."""
    folder = tmp_path_factory.mktemp("doubting")
    run = train_on_one_thread(closed_form_scenes, folder / "run", **DOUBTING)
    options = {"split": "train", "device": "cpu", "progress": False}
    return run, evaluate(run, closed_form_scenes, folder / "report", **options), folder / "report"


def test_the_curve_counts_the_pixels_of_every_probability():
    #           probability, pixels, of which show the object
    groups = [(0.0, 1000, 3), (0.32, 100, 32), (0.82, 50, 10), (1.0, 200, 190)]
    phasor = np.concatenate([np.full(n, p * np.exp(1j)) for p, n, _ in groups])
    mask = np.concatenate([np.arange(n) < shown for _, n, shown in groups])
    order = np.random.default_rng(0).permutation(len(mask))
    count = ReliabilityCount()
    for part in np.array_split(order, 3):
        count.add(phasor[part], mask[part].astype(np.uint8))
    curve = count.curve()
    assert curve.pixels == (1000, 100, 50, 200)
    np.testing.assert_allclose(curve.predicted, [0, 0.32, 0.82, 1])
    np.testing.assert_allclose(curve.observed, [0.003, 0.32, 0.2, 0.95])
    assert curve.calibration_error == pytest.approx(50 * 0.62 / 150)  # without the first and the last bin
    assert Reliability((0.0, 1.0), (0.0, 1.0), (7, 3)).calibration_error is None


def test_a_network_whose_probabilities_hold_expects_the_error_that_it_makes():
    rng = np.random.default_rng(1)
    probability, depth_m = rng.random((40, 50)), rng.uniform(2, 3, (40, 50))
    mask = probability >= 0.5
    phasor = probability * phasor_of_return(depth_m, FREQUENCY_HZ)
    prediction = DepthMap(mask * depth_m, mask, phasor, FREQUENCY_HZ)
    actual_m = []
    for _ in range(50):
        truth = rng.random(probability.shape) < probability
        actual_m.append(image_metrics(mask * depth_m, mask, truth * depth_m, truth).depth_mae_m)
    own_m = expected_mae_m(prediction)
    assert abs(np.mean(actual_m) - own_m) < 4 * np.std(actual_m) / np.sqrt(len(actual_m))
    by_hand_m = [
        p * d if p < 0.5 else (1 - p) * d for p, d in zip(probability.flat, depth_m.flat, strict=True)
    ]
    assert own_m == pytest.approx(np.mean(by_hand_m))
    # Errors of the depth where there is an object, with the mean size that the network expects.
    unsure, actual_m = replace(prediction, depth_error_m=np.full(mask.shape, 0.3)), []
    for _ in range(50):
        truth = rng.random(probability.shape) < probability
        off_m = depth_m + rng.choice([-0.3, 0.3], mask.shape)
        actual_m.append(image_metrics(mask * depth_m, mask, truth * off_m, truth).depth_mae_m)
    own_m = expected_mae_m(unsure)
    assert abs(np.mean(actual_m) - own_m) < 4 * np.std(actual_m) / np.sqrt(len(actual_m))
    sure = DepthMap(mask * depth_m, mask, mask * phasor_of_return(depth_m, FREQUENCY_HZ), FREQUENCY_HZ)
    assert expected_mae_m(sure) == pytest.approx(0, abs=1e-12)


def test_the_report_of_a_network_with_probabilities_has_them(doubting, shards):
    run, report, out = doubting
    content = json.loads((out / "metrics.json").read_text())
    block = shards.read(shards.rows("train"))
    assert sum(content["reliability"]["pixels"]) == block.mask.size
    shown = np.dot(content["reliability"]["pixels"], content["reliability"]["observed"])
    assert shown == pytest.approx(block.mask.sum())
    predictions = load(run, "cpu").predict(block.phasors)
    with (out / "metrics.csv").open(newline="") as stream:
        found = [float(line["expected_mae_m"]) for line in csv.DictReader(stream)]
    np.testing.assert_allclose(found, [expected_mae_m(predictions[i]) for i in range(len(found))], rtol=1e-5)
    assert content["expected_mae_m"]["mean"] == pytest.approx(np.mean(found))
    assert "expected by the network" in report.table
    assert {chart.name for chart in uncertainty_charts(report)} == {"reliability", "expected_mae"}
    assert (out / "figures" / "reliability.png").is_file()


def test_expected_errors_of_the_depth_are_compared_where_the_object_was_found():
    rng = np.random.default_rng(2)
    expected_m = np.repeat([0.004, 0.03, 0.7, 1e-5], 5000).reshape(4, 50, 100)
    truth_m = np.full(expected_m.shape, 3.0)
    depth_m = truth_m + rng.laplace(scale=expected_m)  # whose mean absolute value is the scale
    mask, mask_gt = rng.random((2, *expected_m.shape)) < 0.7
    found = mask & mask_gt
    count = DepthReliabilityCount()
    for part in (slice(0, 1), slice(1, 4)):
        phasor = np.zeros(depth_m[part].shape, np.complex64)
        each = DepthMap((mask * depth_m)[part], mask[part], phasor, FREQUENCY_HZ, expected_m[part])
        count.add(each, (mask_gt * truth_m)[part], mask_gt[part].astype(np.uint8))
    curve = count.curve()
    sizes = [int(found[i].sum()) for i in range(4)]
    assert curve.pixels == (sizes[3], sizes[0], sizes[1], sizes[2])
    np.testing.assert_allclose(curve.expected_m, [1e-5, 0.004, 0.03, 0.7])
    # The standard deviation of |x| is its mean: four standard errors.
    assert np.all(np.abs(np.divide(curve.actual_m, curve.expected_m) - 1) < 4 / np.sqrt(min(sizes)))
    error_m = np.abs(depth_m - truth_m)
    assert curve.means_m == pytest.approx((expected_m[found].mean(), error_m[found].mean()))
    assert curve.as_data()["mean_actual_m"] == curve.means_m[1]
    unexpected = DepthReliabilityCount()
    unexpected.add(DepthMap(depth_m, mask, depth_m * 1j, FREQUENCY_HZ), truth_m, mask_gt)
    assert unexpected.curve() is None


def test_the_report_of_a_network_with_uncertainty_has_the_errors(doubting, shards):
    run, report, out = doubting
    found = json.loads((out / "metrics.json").read_text())["depth_reliability"]
    block = shards.read(shards.rows("train"))
    prediction = load(run, "cpu").predict(block.phasors)
    on_object = prediction.mask & (block.mask > 0)
    assert sum(found["pixels"]) == on_object.sum() > 0
    assert found["mean_expected_m"] == pytest.approx(prediction.depth_error_m[on_object].mean(), rel=1e-5)
    assert (out / "figures" / "depth_error.png").is_file()
    page = (out / "index.html").read_text()
    assert f"{100 * found['mean_expected_m']:.1f} cm are expected" in " ".join(page.split())
    assert "Re and Im" not in page
    assert [chart.name for chart in depth_error_charts(report)] == ["depth_error"]


def test_a_network_without_probabilities_has_no_uncertainty(judged_run):
    report, out = judged_run
    content = json.loads((out / "metrics.json").read_text())
    assert content["reliability"] is None
    assert content["expected_mae_m"] is None
    assert content["depth_reliability"] is None
    assert uncertainty_charts(report) == depth_error_charts(report) == ()
    page = (out / "index.html").read_text()
    assert "predicts no probabilities" in page
    assert "Re and Im are the components" in page
