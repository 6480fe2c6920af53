"""Draw predictions beside the truth: the first test scenes of a dataset, or the worst ones.

For each scene: true depth, predicted depth, and the predicted probability of an object pixel with the outline
of the truth. The worst scenes are those of the largest MAE over all pixels. The printed table says for each
what part of the object is missed, what part of the predicted object is not there, how far off the depth is
where both show the object, and how far the centre of the predicted mask is from that of the true one.

Run:

    .venv/bin/python benchmarks/gallery.py night-40x30 newdata --out gallery.png
    .venv/bin/python benchmarks/gallery.py night-40x30 newdata --worst --count 10 --out worst.png
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from itof import DepthMap
from itof.metrics import ImageMetrics, image_metrics
from itof.pictures.figures import BACKGROUND, depth_range, write_figure
from model.data.feed import Feed
from model.data.shards import open_shards
from model.judging.judged_split import seeing
from model.prediction.expected_error import probabilities
from model.prediction.predictor import BATCH, load
from scenegen import open_dataset

COLUMNS = 2  # scenes in a row
TITLES = ("truth", "prediction", "probability (outline: truth)", "expected error of the depth")
MOST_ERROR_M = 0.1  # and more: white


@dataclass(frozen=True)
class Shown:
    """One scene: its name, truth, prediction and metrics."""

    name: str
    truth: DepthMap
    prediction: DepthMap
    metrics: ImageMetrics

    @property
    def line(self) -> str:
        """What is wrong, as a row of a Markdown table."""
        true, found = self.truth.mask, self.prediction.mask
        both = true & found
        off_m = (self.prediction.radial_depth_m - self.truth.radial_depth_m)[both]
        centres = [
            np.argwhere(mask).mean(axis=0) if mask.any() else np.nan * np.ones(2) for mask in (true, found)
        ]
        cells = (
            f"{100 * self.metrics.depth_mae_m:.2f}",
            f"{100 * (1 - both.sum() / max(true.sum(), 1)):.0f}",
            f"{100 * (1 - both.sum() / max(found.sum(), 1)):.0f}",
            f"{100 * off_m.mean():+.1f}" if both.any() else "-",
            f"{np.hypot(*(centres[1] - centres[0])):.1f}",
        )
        return f"| {self.name} | " + " | ".join(cells) + " |"


def main() -> None:
    """Predict the scenes, choose, draw, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder, or name of a network that comes with NIGHT")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="PNG file")
    parser.add_argument("--count", type=int, default=20, help="number of scenes, default 20")
    parser.add_argument("--worst", action="store_true", help="those of the largest MAE instead of the first")
    given = parser.parse_args()
    scenes = predicted(given.run, given.dataset)
    if given.worst:
        scenes.sort(key=lambda scene: -scene.metrics.depth_mae_m)
    chosen = scenes[: given.count]
    print("| scene | MAE cm | object missed, % | not there, % | depth off, cm | centre off, pixels |")
    print("|---|---|---|---|---|---|")
    for scene in chosen:
        print(scene.line)
    write_figure(given.out, drawn(chosen))


def predicted(run: str, folder: Path) -> list[Shown]:
    """All test scenes of a dataset with their predictions, in the order of the dataset."""
    dataset, predictor = open_dataset(folder), load(run)
    shards = open_shards(dataset)
    predictor = seeing(predictor, dataset, shards)
    places = predictor.config.inputs.places(shards.manifest.frequencies_hz)
    shown = []
    for block in Feed(shards, shards.rows("test"), window_rows=0).in_order(BATCH):
        found = predictor.predict(
            block.phasors[..., places],
            fields_of_view_deg=shards.fields_of_view_deg(block.rows),
        )
        for index, scene_id in enumerate(shards.ids(block.rows)):
            truth = DepthMap.of_object(
                block.radial_depth_m[index], block.mask[index] > 0, predictor.config.readout.frequency_hz
            )
            one = found[index]
            metrics = image_metrics(one.radial_depth_m, one.mask, truth.radial_depth_m, truth.mask)
            shape = dataset.scene(scene_id).object_class.replace("_", " ")
            shown.append(Shown(f"{scene_id} {shape}", truth, one, metrics))
    return shown


def drawn(scenes: list[Shown]) -> Figure:
    """Three pictures for each scene, four if the network expects errors; several scenes in a row."""
    rows = -(-len(scenes) // COLUMNS)
    titles = TITLES if scenes[0].prediction.depth_error_m is not None else TITLES[:3]
    count = len(titles)
    height, width = scenes[0].truth.mask.shape
    each = 1.75  # inches
    figure = Figure(
        figsize=(count * COLUMNS * each, rows * (each * height / width + 0.25)), layout="constrained"
    )
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, count * COLUMNS, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for place, scene in enumerate(scenes):
        row, column = divmod(place, COLUMNS)
        panels = grid[row, count * column : count * (column + 1)]
        near_m, far_m = depth_range(scene.truth, scene.prediction)
        for axes, view in zip(panels, (scene.truth, scene.prediction), strict=False):
            _draw(axes, np.where(view.mask, view.radial_depth_m, np.nan), "viridis", near_m, far_m)
        _draw(panels[2], probabilities(scene.prediction.phasor), "magma", 0, 1)
        if scene.truth.mask.any() and not scene.truth.mask.all():
            panels[2].contour(scene.truth.mask, levels=[0.5], colors="white", linewidths=0.8)
        if scene.prediction.depth_error_m is not None:
            error_m = np.where(scene.prediction.mask, scene.prediction.depth_error_m, np.nan)
            _draw(panels[3], error_m, "magma", 0, MOST_ERROR_M)
        panels[0].set_title(scene.name, fontsize=7, loc="left")
        panels[1].set_title(f"MAE {100 * scene.metrics.depth_mae_m:.1f} cm", fontsize=7, loc="left")
        panels[2].set_title(f"mIoU {scene.metrics.miou:.2f}", fontsize=7, loc="left")
    figure.suptitle("for each scene: " + ", ".join(titles), fontsize=9)
    return figure


def _draw(axes: Any, values: NDArray[np.floating[Any]], colours: str, low: float, high: float) -> None:
    axes.set_axis_on()
    axes.set_facecolor(BACKGROUND)
    axes.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    axes.set(xticks=[], yticks=[])


if __name__ == "__main__":
    main()
