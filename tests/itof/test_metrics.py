"""Metrics give the numbers computed by hand, and those of scikit-learn and torchmetrics."""

import numpy as np
import pytest
import torch
from sklearn.metrics import jaccard_score, mean_absolute_error
from torchmetrics import JaccardIndex, MeanAbsoluteError

from itof.metrics import image_metrics, no_object_metrics, summarise

MASK_GT = np.array([[1, 1, 0], [0, 0, 0]], bool)
DEPTH_GT = np.array([[3.0, 3.2, 0], [0, 0, 0]])
MASK_PRED = np.array([[1, 0, 1], [0, 0, 0]], bool)
DEPTH_PRED = np.array([[3.1, 0, 2.0], [0, 0, 0]])


def test_metrics_of_a_hand_made_image():
    metrics = image_metrics(DEPTH_PRED, MASK_PRED, DEPTH_GT, MASK_GT)
    assert metrics.depth_mae_m == pytest.approx((0.1 + 3.2 + 2.0) / 6)
    assert metrics.object_mae_m == pytest.approx(0.1)
    assert metrics.object_iou == pytest.approx(1 / 3)
    assert metrics.background_iou == pytest.approx(3 / 5)
    assert metrics.miou == pytest.approx((1 / 3 + 3 / 5) / 2)
    assert metrics.accuracy == pytest.approx((1 - 5.3 / 6 + (1 / 3 + 3 / 5) / 2) / 2)


def test_a_perfect_prediction_is_perfect():
    metrics = image_metrics(DEPTH_GT, MASK_GT, DEPTH_GT, MASK_GT)
    assert (metrics.depth_mae_m, metrics.object_mae_m, metrics.miou, metrics.accuracy) == (0, 0, 1, 1)


def test_no_object_scores_half_the_background_iou_and_the_mean_depth():
    metrics = no_object_metrics(DEPTH_GT, MASK_GT)
    assert metrics.depth_mae_m == pytest.approx(6.2 / 6)
    assert metrics.object_mae_m is None
    assert metrics.miou == pytest.approx(4 / 6 / 2)


def test_an_empty_scene_predicted_empty_is_perfect():
    nothing = np.zeros((2, 3))
    metrics = image_metrics(nothing, nothing, nothing, nothing)
    assert metrics.miou == 1
    assert metrics.object_mae_m is None


def test_summary_gives_average_population_deviation_and_extremes_and_skips_what_is_undefined():
    both = [image_metrics(DEPTH_PRED, MASK_PRED, DEPTH_GT, MASK_GT), no_object_metrics(DEPTH_GT, MASK_GT)]
    summary = summarise(both)
    a, b = 5.3 / 6, 6.2 / 6
    assert summary.depth_mae_m.mean == pytest.approx((a + b) / 2)
    assert summary.depth_mae_m.std == pytest.approx((b - a) / 2)
    assert (summary.depth_mae_m.min, summary.depth_mae_m.max) == pytest.approx((a, b))
    # Of two values, half their difference: the deviation of the sample, (b - a) / sqrt(2), over sqrt(2).
    assert summary.depth_mae_m.standard_error == pytest.approx((b - a) / 2)
    assert summary.object_mae_m.count == 1
    assert summary.object_mae_m.standard_error is None
    assert summarise(both[1:]).object_mae_m is None
    with pytest.raises(ValueError, match="no images"):
        summarise([])


def test_images_of_other_sizes_and_nan_are_refused():
    with pytest.raises(ValueError, match="one size"):
        image_metrics(DEPTH_PRED.T, MASK_PRED, DEPTH_GT, MASK_GT)
    with pytest.raises(ValueError, match="NaN"):
        image_metrics(np.full((2, 3), np.nan), MASK_PRED, DEPTH_GT, MASK_GT)


def random_images(kind, seed):
    """Depth and mask (H, W) of prediction and truth; both sides of the images are prime numbers."""
    rng = np.random.default_rng(seed)
    shares = {"both": (0.2, 0.3), "no prediction": (0, 0.3), "no truth": (0.2, 0), "neither": (0, 0)}[kind]
    views = []
    for share in shares:
        mask = rng.random((19, 31)) < share
        views += [np.where(mask, rng.uniform(0.5, 7.0, mask.shape), 0.0), mask]
    return views


KINDS = ("both", "no prediction", "no truth", "neither")


@pytest.mark.parametrize("kind", KINDS)
def test_metrics_are_those_of_scikit_learn(kind):
    depth_pred, mask_pred, depth_gt, mask_gt = random_images(kind, seed=1)
    metrics = image_metrics(depth_pred, mask_pred, depth_gt, mask_gt)
    mae = mean_absolute_error(depth_gt.ravel(), depth_pred.ravel())
    assert metrics.depth_mae_m == pytest.approx(mae, rel=1e-12)  # float64 sums of 589 values
    both = mask_pred & mask_gt
    if both.any():
        on_object = mean_absolute_error(depth_gt[both], depth_pred[both])
        assert metrics.object_mae_m == pytest.approx(on_object, rel=1e-12)
    else:
        assert metrics.object_mae_m is None
    # Two empty masks agree; scikit-learn leaves that 0 / 0 to its caller.
    ious = [jaccard_score(mask_gt.ravel(), mask_pred.ravel(), pos_label=p, zero_division=1) for p in (1, 0)]
    assert [metrics.object_iou, metrics.background_iou] == pytest.approx(ious, rel=1e-12)
    assert metrics.miou == pytest.approx(np.mean(ious), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_metrics_are_those_of_torchmetrics(kind):
    depth_pred, mask_pred, depth_gt, mask_gt = random_images(kind, seed=2)
    metrics = image_metrics(depth_pred, mask_pred, depth_gt, mask_gt)
    mae = MeanAbsoluteError()(torch.from_numpy(depth_pred), torch.from_numpy(depth_gt))
    assert metrics.depth_mae_m == pytest.approx(float(mae), rel=1e-5)  # it sums 589 values in float32
    for background, ours in ((False, metrics.object_iou), (True, metrics.background_iou)):
        masks = [torch.from_numpy((mask ^ background).astype(np.int64)) for mask in (mask_pred, mask_gt)]
        iou = JaccardIndex(task="binary", zero_division=1)(*masks)
        assert ours == pytest.approx(float(iou), rel=1e-6)  # one division in float32
    if mask_pred.any() or mask_gt.any():  # of two empty masks it leaves the object out of the mean
        mean = JaccardIndex(task="multiclass", num_classes=2, average="macro")(
            *(torch.from_numpy(mask.astype(np.int64)) for mask in (mask_pred, mask_gt))
        )
        assert metrics.miou == pytest.approx(float(mean), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_baseline_is_that_of_an_empty_prediction_in_scikit_learn(kind):
    *_, depth_gt, mask_gt = random_images(kind, seed=3)
    metrics = no_object_metrics(depth_gt, mask_gt)
    empty = np.zeros(mask_gt.size)
    assert metrics.depth_mae_m == pytest.approx(mean_absolute_error(depth_gt.ravel(), empty), rel=1e-12)
    iou = jaccard_score(mask_gt.ravel(), empty.astype(bool), zero_division=1)
    assert metrics.object_iou == pytest.approx(iou, rel=1e-12)
