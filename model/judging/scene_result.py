"""Result of one scene: its contents, the metrics of its prediction, and how round the masks are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from itof import DepthMap
from itof.metrics import ImageMetrics, image_metrics, no_object_metrics
from model.prediction.expected_error import expected_mae_m
from model.prediction.explained_light import ExplainedLight
from scenegen import Scene

SAMPLES = 16  # points along each side of a pixel, for the part of it that a disc covers


@dataclass(frozen=True)
class SceneResult:
    """Metrics of a scene, for the prediction and the baseline "no object", and properties that affect them.

    Attributes
    ----------
    roughness : roughness of the relay wall; None for a diffuse wall.
    location_m : centre of the hidden object in world axes, metres; for a composite, of its first part;
        None in an empty corner.
    object_pixels : number of pixels that show the object in the ground truth.
    object_distance_m : mean radial depth of these pixels in the ground truth, metres; None if there are none.
    roundness_gt, roundness_pred : `disc_iou` of the masks of ground truth and prediction; None if empty.
    expected_mae_m : MAE over all pixels that the network expects; None if it predicts no probabilities.
    explained_light : `ExplainedLight.share`; None without residual channels, too.
    """

    scene: str
    object_class: str
    is_composite: bool
    roughness: float | None
    location_m: tuple[float, float, float] | None
    object_pixels: int
    object_distance_m: float | None
    prediction: ImageMetrics
    no_object: ImageMetrics
    roundness_gt: float | None
    roundness_pred: float | None
    expected_mae_m: float | None = None
    explained_light: float | None = None

    def by_distance(self, metrics: ImageMetrics) -> float | None:
        """MAE over all pixels as a part of the object's mean distance; None if the truth shows no object.

        Source: Caligiuri et al. 2024, sec. 6 (about 1 to 2 % of 3 m).
        """
        return metrics.depth_mae_m / self.object_distance_m if self.object_distance_m else None


def judge_scene(
    scene: Scene,
    prediction: DepthMap,
    radial_depth_gt_m: NDArray[np.float32],
    mask_gt: NDArray[np.uint8],
    light: ExplainedLight | None = None,
    *,
    has_probability: bool = False,
) -> SceneResult:
    """Metrics of one (H, W) prediction; true radial depth in metres and true mask are (H, W) too.

    Parameters
    ----------
    light : hidden light of the measurement, and what the prediction explains of it.
    has_probability : the amplitude of the predicted phasor is the probability of the object.
    """
    on_object_m = radial_depth_gt_m[mask_gt > 0]  # (n,)
    return SceneResult(
        scene=scene.id,
        object_class=scene.object_class,
        is_composite=len(scene.hidden_objects) > 1,
        roughness=scene.relay_wall.roughness,
        location_m=scene.hidden_objects[0].location_m if scene.hidden_objects else None,
        object_pixels=len(on_object_m),
        object_distance_m=float(on_object_m.mean(dtype=np.float64)) if len(on_object_m) else None,
        prediction=image_metrics(prediction.radial_depth_m, prediction.mask, radial_depth_gt_m, mask_gt),
        no_object=no_object_metrics(radial_depth_gt_m, mask_gt),
        roundness_gt=disc_iou(mask_gt),
        roundness_pred=disc_iou(prediction.mask),
        expected_mae_m=expected_mae_m(prediction) if has_probability else None,
        explained_light=None if light is None else light.share,
    )


def disc_iou(mask: ArrayLike) -> float | None:
    """Intersection over union of a mask with the disc of equal area at its centroid; None if it is empty.

    1 for a disc, 0.834 for a square, less for all that is long, bent, hollow or in several parts. A sphere is
    seen as a disc, nearly. It needs no perimeter: along the edges of pixels, the perimeter of a disc is that
    of its square, and 4π A / P² would call the square the rounder of the two.

    Parameters
    ----------
    mask : (H, W); pixels are squares of side 1, and the part of the disc outside the image counts.

    Source: Caligiuri et al. 2024, sec. 6.1 (without IoU in the loss, shapes tend to spheres; no number); the
    measure is ours.
    """
    shows = np.asarray(mask).astype(bool)
    rows, columns = np.nonzero(shows)
    area = len(rows)
    if not area:
        return None
    towards = rows - rows.mean(), columns - columns.mean()  # (n,) each, pixel centres from the centroid
    inside = float(_covered(*towards, np.sqrt(area / np.pi)).sum())
    return inside / (2 * area - inside)  # mask and disc have the same area


def _covered(rows: NDArray[np.float64], columns: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """(n,) parts of pixels, with centres at (n,) rows and columns, that a disc at the origin covers."""
    away = np.hypot(rows, columns)
    covered = (away < radius).astype(np.float64)
    cut = np.abs(away - radius) < np.sqrt(0.5)  # the others are inside or outside with all corners
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    y = rows[cut][:, None, None] + steps[:, None]  # (cut, SAMPLES, SAMPLES) with x
    x = columns[cut][:, None, None] + steps
    covered[cut] = (y**2 + x**2 < radius**2).mean(axis=(1, 2))
    return covered
