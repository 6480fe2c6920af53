"""What refinement by rendering bears: walls assumed elsewhere, drifted phases, noise, vignetting, sizes.

Each row changes the measurements of the first test scenes with a single solid, or what is known of them. The
measurements are those of the dataset; the wall is assumed elsewhere. Noise is Gaussian in each component,
relative to the amplitude at the first frequency. Where a fit is not accepted (`Refined.is_right`), the
network's depth map counts.

Run:

    .venv/bin/python benchmarks/refinement_limits.py night-80x60 new80 --scenes 12
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from ablations import cells
from numpy.typing import NDArray
from out_of_range import with_noise
from wall_error import moved_wall

from itof import DepthMap, pixel_rays
from itof.metrics import ImageMetrics, image_metrics, summarise
from model.data.corner import wall_view
from model.data.rows import RowBlock
from model.data.shards import Shards, open_shards
from model.prediction.predictor import Predictor, load
from model.refinement.family import Family
from model.refinement.light.corner_light import CornerLight, known_corner
from model.refinement.refining import refined
from scenegen import Dataset, open_dataset
from scenegen.shapes import PRIMITIVES

HEAD = """| | accepted | network: MAE cm | mIoU | object MAE cm | refined: MAE cm | mIoU | object MAE cm |
|---|---|---|---|---|---|---|---|"""
Phasors = NDArray[np.complexfloating]
Judged = tuple[ImageMetrics, ImageMetrics, bool]  # of the network's depth map, the refined one, and accepted


def unchanged(phasors: Phasors) -> Phasors:
    """The measurement as it is."""
    return phasors


def drifted(phasors: Phasors) -> Phasors:
    """Phases off by 5 mrad, with alternating signs."""
    turned: Phasors = phasors * np.exp(5e-3j * (-1.0) ** np.arange(phasors.shape[-1]))
    return turned


def vignetted(phasors: Phasors) -> Phasors:
    """Amplitudes that fall as the fourth power of the cosine, as behind a simple lens."""
    cosine = pixel_rays(phasors.shape[-2], phasors.shape[-3], 60.0)[..., 2:]
    dimmed: Phasors = phasors * cosine**4
    return dimmed


@dataclass(frozen=True)
class Row:
    """One line of the table: its words, what happens to measurements, to the wall, and to the sizes."""

    words: str
    change: Callable[[Phasors], Phasors] = unchanged
    wall_m: float = 0.0
    wall_deg: float = 0.0
    fits_sizes: bool = False
    size_factor: float = 1.0


ROWS = (
    Row("as rendered"),
    Row("wall assumed 1 cm and 1 degree off, phases off by 5 mrad", drifted, 0.01, 1.0),
    Row("vignetting, fourth power of the cosine", vignetted),
    Row("sizes fitted, from 10 % too small", fits_sizes=True, size_factor=0.9),
    *(
        Row(f"noise {noise:g}", partial(with_noise, noise, np.random.default_rng(0)))
        for noise in (1e-4, 3e-4, 1e-3)
    ),
)


def main() -> None:
    """Refine the scenes of each row, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder, or name of a network that comes with NIGHT")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=12, help="test scenes with one solid, default 12")
    parser.add_argument("--rows", type=int, default=len(ROWS), help="only so many rows of the table")
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    shards, predictor = open_shards(dataset), load(given.run)
    light = CornerLight(predictor.config.inputs.frequencies_hz)
    rows = single_solids(dataset, shards, given.scenes)
    print(f"{len(rows)} scenes\n\n{HEAD}")
    for row in ROWS[: given.rows]:
        found = [judged(row, predictor, dataset, shards, light, place) for place in rows]
        print(table(row.words, found), flush=True)


def judged(
    row: Row, predictor: Predictor, dataset: Dataset, shards: Shards, light: CornerLight, place: int
) -> Judged:
    """A scene of the shards, changed as in a row."""
    block = shards.read([place])
    used = predictor.config.inputs.places(shards.manifest.frequencies_hz)
    phasor = row.change(block.phasors[..., used])[0]
    view = moved_wall(wall_view(dataset), row.wall_m, row.wall_deg)
    height, width, _ = phasor.shape
    frequencies_hz = predictor.config.inputs.frequencies_hz
    wall = view.expected_wall(view.direct_phasors(width, height, frequencies_hz), frequencies_hz)
    prediction = predictor.at(view).predict(phasor, wall.direct)
    sizes = sizes_of(dataset, row.size_factor)
    family, expected_m = Family(sizes, row.fits_sizes), predictor.expected_mae_m(prediction)
    corner = known_corner(dataset.scene(dataset.ids()[0]))
    found = refined(phasor, prediction, expected_m, wall, corner, light, family, seed=place)
    accepted = found is not None and found.is_right(expected_m)
    better = found.depth_map if found is not None and accepted else prediction
    return judgement(block, prediction, better, accepted)


def judgement(block: RowBlock, prediction: DepthMap, better: DepthMap, accepted: bool) -> Judged:
    """Both depth maps of one scene beside the truth."""
    truth = block.radial_depth_m[0], block.mask[0]
    before, after = (image_metrics(each.radial_depth_m, each.mask, *truth) for each in (prediction, better))
    return before, after, accepted


def single_solids(dataset: Dataset, shards: Shards, count: int) -> list[int]:
    """Rows of the first test scenes with one solid."""
    rows = shards.rows("test")
    of_scene = zip(rows, shards.ids(rows), strict=True)
    return [row for row, scene in of_scene if len(dataset.scene(scene).hidden_objects) == 1][:count]


def sizes_of(dataset: Dataset, factor: float = 1.0) -> dict[str, tuple[float, float, float]]:
    """Extents of the shapes of a dataset that can be fitted, metres, times a factor."""
    hidden, sizes = dataset.preset.hidden_object, {}
    for shape in hidden.shapes:
        if shape in PRIMITIVES:
            x, y, z = (factor * side for side in hidden.size_m.of(shape))
            sizes[shape] = (x, y, z)
    return sizes


def table(words: str, found: list[Judged]) -> str:
    """A row of the table."""
    before, after = summarise([each for each, _, _ in found]), summarise([each for _, each, _ in found])
    return f"| {words} | {sum(accepted for *_, accepted in found)} | {cells(before)} | {cells(after)} |"


if __name__ == "__main__":
    main()
