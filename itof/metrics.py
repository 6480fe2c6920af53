"""Metrics of predicted depth maps: error and overlap for one image, and statistics over images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import ArrayLike

from itof.arrays import A

NUMBERS = ("MAE cm", "mIoU", "object MAE cm")  # by which depth maps are compared, as heads of a table


@dataclass(frozen=True)
class ImageMetrics:
    """Metrics of one image. Depth is radial (along the ray) and 0 on background.

    Attributes
    ----------
    depth_mae_m : mean absolute error of depth over *all* pixels, metres.
    object_mae_m : mean absolute error over the pixels that show the object in both prediction and ground
        truth, metres; None if there is no such pixel.
    object_iou, background_iou : intersection over union of the masks; 1 if both are empty.
    """

    depth_mae_m: float
    object_mae_m: float | None
    object_iou: float
    background_iou: float

    @property
    def miou(self) -> float:
        """Mean of object IoU and background IoU."""
        return (self.object_iou + self.background_iou) / 2

    @property
    def accuracy(self) -> float:
        """Mean of (1 - MAE in metres) and mIoU. The paper plots an accuracy but does not define it.

        With the averages of its Table 1 this definition gives 0.859, which is the mean of its histogram.
        """
        return (1 - self.depth_mae_m + self.miou) / 2


@dataclass(frozen=True)
class Statistics:
    """Mean, population standard deviation, minimum and maximum of `count` values."""

    mean: float
    std: float
    min: float
    max: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Statistics:
        """Statistics of at least one value."""
        x = np.asarray(values, dtype=np.float64)
        return cls(float(x.mean()), float(x.std()), float(x.min()), float(x.max()), len(x))

    @property
    def standard_error(self) -> float | None:
        """Of the mean, without bias: `std` over the root of `count` - 1. One value does not tell it: None."""
        return self.std / math.sqrt(self.count - 1) if self.count > 1 else None


@dataclass(frozen=True)
class Summary:
    """Statistics over images; `object_mae_m` covers the images that have one, and is None if none has."""

    depth_mae_m: Statistics
    object_mae_m: Statistics | None
    object_iou: Statistics
    miou: Statistics
    accuracy: Statistics


def image_metrics(
    radial_depth_pred_m: ArrayLike, mask_pred: ArrayLike, radial_depth_gt_m: ArrayLike, mask_gt: ArrayLike
) -> ImageMetrics:
    """Metrics of one (H, W) prediction; depths in metres, 0 on background.

    Raises
    ------
    ValueError : the images differ in size, or a depth is not finite.

    Source: Caligiuri et al. 2024, sec. 6 (MAE and mIoU); that MAE counts all pixels, and mIoU object and
    background, is our reading (docs/science/paper.md).
    """
    depth_pred, depth_gt = (np.asarray(d, dtype=np.float64) for d in (radial_depth_pred_m, radial_depth_gt_m))
    pred, truth = (np.asarray(m).astype(bool) for m in (mask_pred, mask_gt))
    shapes = {depth_pred.shape, depth_gt.shape, pred.shape, truth.shape}
    if len(shapes) != 1 or len(depth_gt.shape) != 2:
        raise ValueError(
            f"prediction and ground truth must be images of one size, got shapes {sorted(shapes)}"
        )
    error = np.abs(depth_pred - depth_gt)  # (H, W)
    if not np.isfinite(error).all():
        raise ValueError("a depth map holds NaN or infinite values")
    both = pred & truth
    return ImageMetrics(
        depth_mae_m=float(error.mean()),
        object_mae_m=float(error[both].mean()) if both.any() else None,
        object_iou=float(mask_iou(pred, truth)),
        background_iou=float(mask_iou(~pred, ~truth)),
    )


def mask_iou(pred: A, truth: A) -> A:
    """(...) intersection over union of (..., H, W) bool masks; 1 if both are empty.

    The masks are arrays of numpy, torch or another library of the array API.
    """
    xp = array_namespace(pred, truth)
    union = xp.sum(xp.astype(pred | truth, xp.float64), axis=(-2, -1))  # (...)
    intersection = xp.sum(xp.astype(pred & truth, xp.float64), axis=(-2, -1))
    return xp.where(union > 0, intersection / xp.where(union > 0, union, 1.0), 1.0)


def no_object_metrics(radial_depth_gt_m: ArrayLike, mask_gt: ArrayLike) -> ImageMetrics:
    """Metrics of the baseline, which predicts "no object" in every pixel."""
    truth = np.asarray(radial_depth_gt_m)
    return image_metrics(np.zeros(truth.shape), np.zeros(truth.shape, bool), truth, mask_gt)


def summarise(metrics: Sequence[ImageMetrics]) -> Summary:
    """Statistics over images.

    Raises
    ------
    ValueError : `metrics` is empty.
    """
    if not metrics:
        raise ValueError("there are no images to summarise")
    values = {
        field.name: [v for m in metrics if (v := getattr(m, field.name)) is not None]
        for field in fields(Summary)
    }
    return Summary(
        depth_mae_m=Statistics.of(values["depth_mae_m"]),
        object_mae_m=Statistics.of(values["object_mae_m"]) if values["object_mae_m"] else None,
        object_iou=Statistics.of(values["object_iou"]),
        miou=Statistics.of(values["miou"]),
        accuracy=Statistics.of(values["accuracy"]),
    )


def summary_cells(summary: Summary) -> tuple[str, str, str]:
    """MAE, mIoU and object MAE with their standard errors; ``-`` where nothing tells the number."""
    cells = []
    for found, factor, digits in (
        (summary.depth_mae_m, 100, 2),
        (summary.miou, 1, 3),
        (summary.object_mae_m, 100, 2),
    ):
        if found is None:
            cells.append("-")
        else:
            error = found.standard_error
            told = "-" if error is None else f"{factor * error:.{digits}f}"
            cells.append(f"{factor * found.mean:.{digits}f} ± {told}")
    return cells[0], cells[1], cells[2]
