"""Single scenes for the report page: pictures, and point clouds that the reader can rotate."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.prediction.figures import write_figure
from model.report.comparison import comparison_figure, describe
from model.report.results import Report
from model.report.showcase import Cloud, ShownScene, cloud_of


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
        file = figures / f"{scene.rank}.png"
        write_figure(file, figure)
        width, height = (round(length * figure.dpi) for length in figure.get_size_inches())
        parts.append(
            {
                "png": base64.b64encode(file.read_bytes()).decode(),
                "width": width,
                "height": height,
                "text": f"{title}. {describe(result.prediction)}",
            }
        )
    return parts


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
    """Points and their box, metres; millimetres are enough. None where there is no point."""
    if cloud is None:
        return None
    return {
        "truth": _rounded(cloud.truth),
        "prediction": _rounded(cloud.prediction),
        "centre": _rounded(cloud.centre_m),
        "reach": round(cloud.reach_m, 3),
    }


def _rounded(points_m: NDArray[np.float32]) -> Any:
    return np.round(points_m.astype(np.float64), 3).tolist()
