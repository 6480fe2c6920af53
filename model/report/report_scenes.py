"""The part of the report page that shows single scenes: pictures, and point clouds to be turned."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.prediction.figures import comparison_figure, describe, write_figure
from model.report.report_html import Section, grid, note
from model.report.results import Report
from model.report.showcase import Cloud, ShownScene


def pictures(report: Report, shown: Sequence[ShownScene], figures: Path) -> Section:
    """Truth and prediction of the shown scenes; each picture is also written to `figures`."""
    parts = []
    for scene in shown:
        result = scene.result
        rank = f"{scene.rank} of {len(report.scenes)} {report.split} scenes"
        title = f"{rank}: {result.scene}, {result.object_class}"
        # A $ would begin a formula in the picture's title.
        figure = comparison_figure(
            title.replace("$", r"\$"), scene.truth, scene.prediction, result.prediction
        )
        write_figure(figures / f"{scene.rank}.png", figure)
        data = base64.b64encode((figures / f"{scene.rank}.png").read_bytes()).decode()
        width, height = (round(length * figure.dpi) for length in figure.get_size_inches())
        text = escape(f"{title}. {describe(result.prediction)}")
        size = f'width="{width}" height="{height}"'
        parts.append(
            f'<figure class="wide"><img src="data:image/png;base64,{data}" {size} alt="{text}"></figure>'
        )
    return Section(
        "scenes",
        "Best, median and worst scene",
        "By accuracy. Above the truth, below the prediction: the two components of the mirrored scene's "
        "phasor, which the network predicts, and the depth read from them; both rows share their colours.",
        "\n".join(parts),
    )


def point_clouds(shown: Sequence[ShownScene], clouds: Sequence[Cloud | None]) -> Section:
    """Boxes that ``clouds.js`` draws the points into."""
    parts = []
    for place, (scene, cloud) in enumerate(zip(shown, clouds, strict=True)):
        stray = f"; {cloud.outside} points lie outside the box" if cloud and cloud.outside else ""
        caption = f"{len(scene.points_gt_m)} true points, {len(scene.points_pred_m)} predicted{stray}."
        parts.append(
            f"<h3>{escape(f'{scene.rank}: {scene.result.scene}, {scene.result.object_class}')}</h3>"
            f'<div class="cloud" data-cloud="{place}" role="img" aria-label="{escape(caption)}">'
            "<p>The point cloud is drawn by a script, and this browser runs none here.</p></div>"
            f"{note(caption)}"
        )
    return Section(
        "clouds",
        "Point clouds",
        "The same scenes in space, as the camera would see the object in a relay wall that were a mirror. "
        "Axes are the camera's: x to the right, y down, z forward, metres, camera at the origin; one metre "
        "is as long on every axis. Drag to turn, pinch or use the buttons to zoom.",
        '<p><span class="key truth"></span>truth<span class="key prediction"></span>prediction</p>'
        + grid(parts, "three"),
    )


def cloud_data(cloud: Cloud | None) -> dict[str, Any] | None:
    """What the page's script needs of a cloud; millimetres are enough."""
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
