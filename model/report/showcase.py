"""Scenes that the report shows as picture and point cloud: the best, the median and the worst."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap
from model.report.scene_result import SceneResult

CLOUD_POINTS = 5000  # limit for a cloud of the page; the PLY files have all points
LEAST_REACH_M = 0.3  # smallest half side of the cube in which a cloud is drawn
MOST = 0.97  # share of all points that the cube contains


@dataclass(frozen=True)
class ShownScene:
    """One scene of the report; points are (n, 3) in camera axes (`model.prediction.pointclouds`), metres."""

    rank: str
    result: SceneResult
    truth: DepthMap
    prediction: DepthMap
    points_gt_m: NDArray[np.float32]
    points_pred_m: NDArray[np.float32]


@dataclass(frozen=True)
class Cloud:
    """Points of a scene as the page draws them.

    Attributes
    ----------
    truth, prediction : (n, 3) points, metres; at most CLOUD_POINTS, taken at equal steps.
    centre_m, reach_m : centre (3,) and half side of the cube that is drawn, metres.
    outside : number of points outside the cube, among all points.
    """

    truth: NDArray[np.float32]
    prediction: NDArray[np.float32]
    centre_m: NDArray[np.float32]
    reach_m: float
    outside: int


def choose(ranked: list[SceneResult]) -> dict[str, SceneResult]:
    """The best, the median and the worst scene of `ranked` (best first); they may be the same scene."""
    return {"best": ranked[0], "median": ranked[(len(ranked) - 1) // 2], "worst": ranked[-1]}


def cloud_of(shown: ShownScene) -> Cloud | None:
    """Points and cube of a scene; None if neither ground truth nor prediction shows an object.

    The cube surrounds the true object, or the predicted one if there is no true object, and is enlarged until
    it contains the share MOST of all points. A cube around all points would make the object tiny if a few
    predicted pixels are metres away.
    """
    both = np.concatenate([shown.points_gt_m, shown.points_pred_m])  # (n, 3)
    if not len(both):
        return None
    middle = shown.points_gt_m if len(shown.points_gt_m) else both
    centre_m = (middle.min(axis=0) + middle.max(axis=0)) / 2
    away_m = np.abs(both - centre_m).max(axis=1)  # (n,)
    needed_m = max(np.abs(middle - centre_m).max(), np.quantile(away_m, MOST))
    reach_m = max(LEAST_REACH_M, 1.1 * float(needed_m))
    return Cloud(
        _thinned(shown.points_gt_m),
        _thinned(shown.points_pred_m),
        centre_m,
        reach_m,
        int(np.count_nonzero(away_m > reach_m)),
    )


def _thinned(points: NDArray[np.float32]) -> NDArray[np.float32]:
    step = -(-len(points) // CLOUD_POINTS)
    return points[:: max(step, 1)]
