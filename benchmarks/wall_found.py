"""Where valid measurements show the relay wall: how far hidden light and noise move the fit of the wall.

The wall is where the scenes have it, so everything that is found is error: it decides from which shift on the
program may warn (docs/science/design.md, Wall found in the measurement). Run:

    .venv/bin/python benchmarks/wall_found.py DATASET
"""

import argparse
from pathlib import Path

import numpy as np

from itof import read_image
from itof.wall.expected_wall import ExpectedWall
from itof.wall.plausibility import check_measurement
from itof.wall.wall_fit import RobustFit
from model.data.corner import wall_view
from scenegen import Dataset, open_dataset

COLUMNS = ("misfit, mrad", "mean shift, mm", "distance, mm", "tilt, °", "residual rms, mrad", "1 - coherence")


def main() -> None:
    """Print median and maximum over all scenes, for each noise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument(
        "--noises", type=float, nargs="+", default=[0, 0.01], help="of each pixel's amplitude"
    )
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    images = [read_image(dataset.render_folder(each) / "itof.exr").phasors()[0] for each in dataset.ids()]
    wall = expected_wall(dataset, *images[0].shape[:2])
    print(f"{len(images)} scenes\n\n| noise | | {' | '.join(COLUMNS)} | findings |\n|---{'|---' * 8}|")
    for noise in given.noises:
        rng = np.random.default_rng(0)
        rows, findings = [], 0
        for image in images:
            grain = rng.standard_normal(image.shape) + 1j * rng.standard_normal(image.shape)
            found = check_measurement(image * (1 + noise * grain), wall)
            findings += len(found.findings)
            rows += [] if found.wall is None else [statistics(found.wall)]
        for name, values in (("median", np.median(rows, axis=0)), ("maximum", np.max(rows, axis=0))):
            print(f"| {noise:g} | {name} | {' | '.join(f'{value:.2g}' for value in values)} | {findings} |")


def expected_wall(dataset: Dataset, height: int, width: int) -> ExpectedWall:
    """The relay wall of a dataset where its camera should see it."""
    view, frequencies_hz = wall_view(dataset), dataset.preset.itof.frequencies_hz
    direct = view.direct_phasors(width, height, frequencies_hz)
    place = (view.camera_axes, view.camera_location_m, view.wall_point_m, view.wall_normal)
    return ExpectedWall.of_camera(direct, frequencies_hz, view.horizontal_fov_deg, *place)


def statistics(fit: RobustFit) -> list[float]:
    """The numbers of one scene, in the order of `COLUMNS`."""
    return [
        1e3 * fit.misfit_rad.max(),
        1e3 * fit.mean_shift_m,
        1e3 * abs(fit.distance_shift_m),
        fit.tilt_deg,
        1e3 * fit.residual_rms_rad.max(),
        1 - fit.coherence.min(),
    ]


if __name__ == "__main__":
    main()
