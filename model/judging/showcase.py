"""Scenes that the report shows as pictures and point clouds.

The best, the median and the worst are shown one by one. The figures of several scenes show those that the
user names, or some that are spread by accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap
from itof.pictures.pointclouds import distances_m
from model.judging.scene_result import SceneResult

CLOUD_POINTS = 5000  # limit for a cloud of the page; the PLY files have all points
FIGURE_SCENES = 5  # in a figure of several scenes, as in the paper's
LONGEST_NAME = 18  # characters of a class in a figure
LEAST_REACH_M = 0.3  # smallest half side of the cube in which a cloud is drawn
MOST = 0.97  # share of all points that the cube contains


@dataclass(frozen=True)
class ShownScene:
    """One scene of the report; points are (n, 3) in camera axes (`itof.pictures.pointclouds`), metres.

    `rank` is its place by accuracy, for readers: "best", "rank 3 of 80". `walls_m` (2, 4, 3) holds the
    corners of relay wall and middle wall in these axes.
    """

    rank: str
    result: SceneResult
    truth: DepthMap
    prediction: DepthMap
    points_gt_m: NDArray[np.float32]
    points_pred_m: NDArray[np.float32]
    walls_m: NDArray[np.float64]


@dataclass(frozen=True)
class Cloud:
    """Points of a scene as the page draws them.

    Attributes
    ----------
    truth, prediction : (n, 3) points, metres; at most CLOUD_POINTS, taken at equal steps.
    distance_m : (n,) distances of the points of the prediction from the truth, metres; infinite if the truth
        shows no object.
    centre_m, reach_m : centre (3,) and half side of the cube that is drawn, metres.
    outside : number of points outside the cube, among all points.
    """

    truth: NDArray[np.float32]
    prediction: NDArray[np.float32]
    distance_m: NDArray[np.float64]
    centre_m: NDArray[np.float32]
    reach_m: float
    outside: int


def choose(ranked: list[SceneResult]) -> dict[str, SceneResult]:
    """The best, the median and the worst scene of `ranked` (best first); they may be the same scene."""
    return {"best": ranked[0], "median": ranked[(len(ranked) - 1) // 2], "worst": ranked[-1]}


def choose_for_figures(ranked: Sequence[SceneResult], wanted: Sequence[str]) -> dict[str, SceneResult]:
    """Scenes of the figures of several scenes, by rank.

    Parameters
    ----------
    ranked : all scenes, the best first.
    wanted : ids of the scenes to show, in this order; none takes FIGURE_SCENES scenes at equal steps from the
        best to the worst, or all if there are fewer.
    """
    places = {result.scene: place for place, result in enumerate(ranked)}
    if wanted:
        chosen = [places[scene] for scene in dict.fromkeys(wanted)]
    else:
        count = min(FIGURE_SCENES, len(ranked))
        chosen = np.linspace(0, len(ranked) - 1, count).round().astype(int).tolist()
    return {f"rank {place + 1} of {len(ranked)}": ranked[place] for place in chosen}


def short_name(object_class: str) -> str:
    """The class of an object, for the small print of a figure."""
    name = object_class.replace("_", " ")
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


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
    prediction = _thinned(shown.points_pred_m)
    return Cloud(
        _thinned(shown.points_gt_m),
        prediction,
        distances_m(prediction, shown.points_gt_m),
        centre_m,
        reach_m,
        int(np.count_nonzero(away_m > reach_m)),
    )


def _thinned(points: NDArray[np.float32]) -> NDArray[np.float32]:
    step = -(-len(points) // CLOUD_POINTS)
    return points[:: max(step, 1)]
