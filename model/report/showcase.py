"""The scenes a report shows: the best, the median and the worst, as pictures and as points in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap
from model.report.scene_result import SceneResult

CLOUD_POINTS = 5000  # of one cloud in the page; the PLY files have all
LEAST_REACH_M = 0.3  # half the side of the box a cloud is drawn in
MOST = 0.97  # of all points lie inside that box


@dataclass(frozen=True)
class ShownScene:
    """One scene of the report; points are in camera axes (`model.prediction.pointclouds`), metres, (n, 3)."""

    rank: str
    result: SceneResult
    truth: DepthMap
    prediction: DepthMap
    points_gt_m: NDArray[np.float32]
    points_pred_m: NDArray[np.float32]


@dataclass(frozen=True)
class Cloud:
    """The points of a scene as the page draws them.

    Attributes
    ----------
    truth, prediction : (n, 3) points, metres, at most CLOUD_POINTS, evenly thinned.
    centre_m, reach_m : a cube around the true object that holds most of all points, and its half side.
    outside : how many points, before thinning, lie outside.
    """

    truth: NDArray[np.float32]
    prediction: NDArray[np.float32]
    centre_m: NDArray[np.float32]
    reach_m: float
    outside: int


def choose(ranked: list[SceneResult]) -> dict[str, SceneResult]:
    """The best, the median and the worst of scenes that stand best first; one scene may be all three."""
    return {"best": ranked[0], "median": ranked[(len(ranked) - 1) // 2], "worst": ranked[-1]}


def cloud_of(shown: ShownScene) -> Cloud | None:
    """What to draw of a scene; None where neither truth nor prediction shows an object.

    The box is that of the true object where there is one, and grows until it holds MOST points: a few stray
    pixels metres away would else leave a first view of dots.
    """
    both = np.concatenate([shown.points_gt_m, shown.points_pred_m])  # (n, 3)
    if not len(both):
        return None
    middle = shown.points_gt_m if len(shown.points_gt_m) else both
    centre_m = (middle.min(axis=0) + middle.max(axis=0)) / 2  # the mean of two, not a path length
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
    step = -(-len(points) // CLOUD_POINTS)  # rounded up
    return points[:: max(step, 1)]
