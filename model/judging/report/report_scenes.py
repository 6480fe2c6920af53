"""Scenes for the report page: pictures, and point clouds, as in Fig. 6 of the paper or to be rotated."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from itof.pictures.figures import plain, svg_of, write_figure, write_pdf
from itof.pictures.pointclouds import (
    DISTANCE_COLOUR_MAP,
    DISTANCE_COLOURS,
    FAR_M,
    TRUTH_COLOUR,
    distance_colours,
    distances_m,
)
from model.judging.report.scenes_figure import describe, scenes_figure
from model.judging.report.sequence_film import FILM_FILE
from model.judging.results import Report
from model.judging.scene_sheet import SceneSheet
from model.judging.showcase import Cloud, ShownScene, cloud_of, short_name

COLUMNS = 5  # scenes side by side
SIDE, HEAD, FOOT = 2.9, 0.35, 0.75  # inches: of one scene; of its title; of the colour bar below all
DOT_AREA = 2400.0  # square points that the dots of a scene cover, if that gives dots of a useful size
ELEVATION_DEG, AZIMUTH_DEG = 22.0, -60.0  # of the view, to the right of the camera's own and above it


def scenes_picture(scenes: Sequence[ShownScene], target: str, file: Path) -> dict[str, Any]:
    """Truth and prediction of scenes in one picture, written to a PNG `file` and to a PDF beside it.

    Returns
    -------
    `drawing`, for the page, and `text` for readers who do not see it.
    """
    said = "; ".join(
        f"{one.rank}: {one.result.scene}, {one.result.object_class}, {describe(one.result.prediction)}"
        for one in scenes
    )
    return _written(file, scenes_figure(scenes, target), f"Truth and prediction. {said}")


def every_scene(report: Report, sheet: SceneSheet) -> dict[str, Any]:
    """The picture of all scenes by accuracy, and what the page says of each, for ``scenes.js``."""
    ranked = report.ranked
    ranges_m = [sheet.ranges_m[result.scene] for result in ranked]
    texts = [
        f"{place} of {len(ranked)}: {result.scene}, {result.object_class}, {describe(result.prediction)}; "
        f"colours from {near_m:.2f} to {far_m:.2f} m"
        for place, (result, (near_m, far_m)) in enumerate(zip(ranked, ranges_m, strict=True), 1)
    ]
    return {**sheet.as_data([result.scene for result in ranked]), "texts": texts}


def clouds_picture(figured: Sequence[ShownScene], figures: Path) -> dict[str, Any]:
    """Point clouds of several scenes in one picture, as in `scenes_picture`; ``point_clouds.png``."""
    scenes = "; ".join(f"{scene.result.scene}, {scene.result.object_class}" for scene in figured)
    return _written(figures / "point_clouds.png", clouds_figure(figured), f"Point clouds of {scenes}")


def film_picture(out: Path) -> dict[str, Any]:
    """The film of a sequence: `src` (its data), and `width` and `height` in pixels."""
    with Image.open(out / FILM_FILE) as film:
        width, height = film.size
    gif = base64.b64encode((out / FILM_FILE).read_bytes()).decode()
    return {"src": f"data:image/gif;base64,{gif}", "width": width, "height": height}


def _written(file: Path, figure: Figure, text: str) -> dict[str, Any]:
    """Write a picture, and what the page needs of it."""
    write_figure(file, figure)
    write_pdf(file.with_suffix(".pdf"), figure)
    return {"drawing": Markup(svg_of(file.stem, figure)), "text": text}  # noqa: S704 -- its texts are outlines


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
                "points": _points(cloud, scene.walls_m),
            }
        )
    return parts


def _points(cloud: Cloud | None, walls_m: NDArray[np.float64]) -> dict[str, Any] | None:
    """Points, their box, and the walls, metres; millimetres are enough. None where there is no point.

    The points p of the relay wall have `plane` · p = 1.
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
        "walls": _rounded(walls_m),
        "plane": np.linalg.lstsq(walls_m[0], np.ones(4), rcond=None)[0].tolist(),
    }


def cloud_colours() -> dict[str, Any]:
    """Colours of the points: of the truth, and of the prediction from distance 0 to `far` (metres)."""
    return {"truth": TRUTH_COLOUR, "distance": list(DISTANCE_COLOURS), "far": FAR_M}


def _rounded(points_m: NDArray[np.floating[Any]]) -> Any:
    return np.round(points_m.astype(np.float64), 3).tolist()


def clouds_figure(shown: Sequence[ShownScene]) -> Figure:
    """True points blue, predicted points from green to red by their distance from the truth.

    The axes are those of the camera, with its y axis (down) drawn downwards: right, forward and down. The
    cube of a scene is that of `cloud_of`; points outside it are left out.

    Parameters
    ----------
    shown : scenes, at least one.

    Source: Caligiuri et al. 2024, Fig. 6 (colours); the scale and the view are ours.
    """
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    width, height = max(columns, 2) * SIDE, rows * (SIDE + HEAD) + FOOT
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    for place, scene in enumerate(shown):
        row, column = divmod(place, columns)
        bottom = FOOT + (rows - 1 - row) * (SIDE + HEAD)
        box = (column * SIDE / width, bottom / height, SIDE / width, SIDE / height)
        _draw(figure.add_axes(box, projection="3d"), scene)
    _legend(figure)
    return figure


def _draw(axes: Any, scene: ShownScene) -> None:
    """Draw the points of one scene, with the mean distance of the predicted points above them.

    `axes` are matplotlib's three-dimensional ones, which have no types.
    """
    result = scene.result
    axes.set_title(
        plain(f"{result.scene}, {short_name(result.object_class)}\n{_said(scene)}"), fontsize=9, y=0.97
    )
    axes.tick_params(labelsize=7, pad=-3)
    axes.tick_params(axis="z", pad=3)  # matplotlib puts these numbers on the line
    axes.view_init(elev=ELEVATION_DEG, azim=AZIMUTH_DEG)
    axes.set_box_aspect((1, 1, 1), zoom=0.78)
    cloud = cloud_of(scene)
    if cloud is None:
        return
    points_m, colours = _coloured(cloud)
    # One collection: matplotlib sorts the points of a collection by depth, so near points hide far ones.
    axes.scatter(
        *_axes_of_view(points_m).T,
        c=colours,
        s=_dot_size(len(points_m)),
        linewidths=0,
        depthshade=False,
        rasterized=True,  # thousands of dots would make large files
    )
    centre_m = _axes_of_view(cloud.centre_m)
    names = ("right, m", "forward, m", "up, m")
    for axis, name, middle_m in zip("xyz", names, centre_m, strict=True):
        getattr(axes, f"set_{axis}lim")(middle_m - cloud.reach_m, middle_m + cloud.reach_m)
        getattr(axes, f"set_{axis}label")(name, fontsize=7, labelpad=2 if axis == "z" else -5)
        getattr(axes, f"{axis}axis").set_major_locator(MaxNLocator(4))


def _coloured(cloud: Cloud) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """The (n, 3) points of a cloud inside its cube, and their (n, 4) RGBA in [0, 1]."""
    truth = np.broadcast_to(to_rgba(TRUTH_COLOUR), (len(cloud.truth), 4))
    points_m = np.concatenate([cloud.truth, cloud.prediction])
    colours = np.concatenate([truth, distance_colours(cloud.distance_m) / 255])
    inside = (np.abs(points_m - cloud.centre_m) <= cloud.reach_m).all(axis=1)
    return points_m[inside], colours[inside]


def _dot_size(count: int) -> float:
    """Area of a dot, square points: larger where there are few of them."""
    return float(np.clip(DOT_AREA / max(count, 1), 1.0, 8.0))


def _axes_of_view(points_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """(..., 3) right, forward and up of points in camera axes, whose y axis is down and z axis forward."""
    return points_m[..., [0, 2, 1]] * np.array([1, 1, -1], np.float32)


def _said(scene: ShownScene) -> str:
    """How far the predicted points are from the truth, as text."""
    if not len(scene.points_pred_m):
        return "no predicted point"
    if not len(scene.points_gt_m):
        return "no true point"
    mean_m = float(distances_m(scene.points_pred_m, scene.points_gt_m).mean())
    return f"mean distance {100 * mean_m:.1f} cm"


def _legend(figure: Figure) -> None:
    """What the colours mean, below the scenes."""
    width, height = figure.get_size_inches()
    middle = width / 2
    dot = Line2D([], [], marker="o", linestyle="none", color=TRUTH_COLOUR, markersize=6, label="truth")
    left = ((middle - 1.6) / width, 0.42 / height)
    figure.legend(handles=[dot], loc="center right", bbox_to_anchor=left, frameon=False, fontsize=9)
    axes = figure.add_axes(((middle - 1.2) / width, 0.38 / height, 2.6 / width, 0.12 / height))
    colours = ScalarMappable(Normalize(0, 100 * FAR_M), DISTANCE_COLOUR_MAP)
    bar = figure.colorbar(colours, cax=axes, orientation="horizontal", extend="max")
    bar.set_label("prediction: distance from the nearest true point, cm", fontsize=8)
    bar.ax.tick_params(labelsize=8)
