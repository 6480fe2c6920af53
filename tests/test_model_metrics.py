"""Metrics against numbers worked out by hand."""

import numpy as np
import pytest

from model import image_metrics, no_object_metrics, summarise

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
    assert summary.object_mae_m.count == 1
    assert summarise(both[1:]).object_mae_m is None
    with pytest.raises(ValueError, match="no images"):
        summarise([])


def test_images_of_other_sizes_and_nan_are_refused():
    with pytest.raises(ValueError, match="one size"):
        image_metrics(DEPTH_PRED.T, MASK_PRED, DEPTH_GT, MASK_GT)
    with pytest.raises(ValueError, match="NaN"):
        image_metrics(np.full((2, 3), np.nan), MASK_PRED, DEPTH_GT, MASK_GT)
