"""Single scenes for the report page: pictures, and point clouds that the reader can rotate."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from itof.pictures.figures import write_figure
from itof.pictures.pointclouds import DISTANCE_COLOURS, FAR_M, TRUTH_COLOUR
from model.judging.report.clouds_figure import clouds_figure
from model.judging.report.comparison import comparison_figure, describe
from model.judging.report.scenes_figure import scenes_figure
from model.judging.results import Report
from model.judging.showcase import Cloud, ShownScene, cloud_of


def pictures(report: Report, shown: Sequence[ShownScene], figures: Path) -> list[dict[str, Any]]:
    """Truth and prediction of the shown scenes, written to the folder `figures`.

    Returns
    -------
    One dictionary for each picture: `png` (base64), `width` and `height` in pixels, and `text` for readers
    who do not see it.
    """
    parts = []
    for scene in shown:
        result = scene.result
        rank = f"{scene.rank} of {len(report.scenes)} {report.split} scenes"
        title = f"{rank}: {result.scene}, {result.object_class}"
        figure = comparison_figure(title, scene.truth, scene.prediction, result.prediction)
        text = f"{title}. {describe(result.prediction)}"
        parts.append(_written(figures / f"{scene.rank}.png", figure, text))
    return parts


def scenes_picture(figured: Sequence[ShownScene], figures: Path) -> dict[str, Any]:
    """Truth beside prediction of several scenes in one picture, as in `pictures`; ``scenes.png``."""
    scenes = "; ".join(
        f"{scene.result.scene}, {scene.result.object_class}: {describe(scene.result.prediction)}"
        for scene in figured
    )
    return _written(figures / "scenes.png", scenes_figure(figured), f"Truth and prediction of {scenes}")


def clouds_picture(figured: Sequence[ShownScene], figures: Path) -> dict[str, Any]:
    """Point clouds of several scenes in one picture, as in `pictures`; ``point_clouds.png``."""
    scenes = "; ".join(f"{scene.result.scene}, {scene.result.object_class}" for scene in figured)
    return _written(figures / "point_clouds.png", clouds_figure(figured), f"Point clouds of {scenes}")


def _written(file: Path, figure: Figure, text: str) -> dict[str, Any]:
    """Write a picture, and what the page needs of it."""
    write_figure(file, figure)
    width, height = (round(length * figure.dpi) for length in figure.get_size_inches())
    png = base64.b64encode(file.read_bytes()).decode()
    return {"png": png, "width": width, "height": height, "text": text}


def point_clouds(shown: Sequence[ShownScene]) -> list[dict[str, Any]]:
    """Point clouds of the shown scenes: a title, counts of points, and `points` for ``clouds.js``."""
    parts = []
    for scene in shown:
        cloud = cloud_of(scene)
        parts.append(
            {
                "title": f"{scene.rank}: {scene.result.scene}, {scene.result.object_class}",
                "true_count": len(scene.points_gt_m),
                "predicted_count": len(scene.points_pred_m),
                "outside_count": cloud.outside if cloud else 0,
                "points": _points(cloud),
            }
        )
    return parts


def _points(cloud: Cloud | None) -> dict[str, Any] | None:
    """Points and their box, metres; millimetres are enough. None where there is no point.

    Distances from the truth end at FAR_M, as their colours do.
    """
    if cloud is None:
        return None
    return {
        "truth": _rounded(cloud.truth),
        "prediction": _rounded(cloud.prediction),
        "distance": _rounded(np.minimum(cloud.distance_m, FAR_M)),
        "centre": _rounded(cloud.centre_m),
        "reach": round(cloud.reach_m, 3),
    }


def cloud_colours() -> dict[str, Any]:
    """Colours of the points: of the truth, and of the prediction from distance 0 to `far` (metres)."""
    return {"truth": TRUTH_COLOUR, "distance": list(DISTANCE_COLOURS), "far": FAR_M}


def _rounded(points_m: NDArray[np.floating[Any]]) -> Any:
    return np.round(points_m.astype(np.float64), 3).tolist()
