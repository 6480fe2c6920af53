r"""What is left of square waves: the error of a network by phase steps and by calibration.

The test scenes are measured without noise by a camera of data/sensors whose waves are square, with several
numbers of phase steps, and with a part of the error that a calibration leaves. Each is predicted as it is,
and with a capture of the empty corner by the same camera as reference. Run:

    .venv/bin/python benchmarks/wave_errors.py night-80x60 new80 --scenes 24
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from ablations import cells

from itof import DepthMap, read_image
from itof.metrics import Summary, image_metrics, summarise
from itof.sensor.binned import BinnedCamera
from itof.sensor.cameras import load_sensor
from itof.sensor.imperfections import without
from itof.sensor.settings import SensorSettings
from model.prediction.predictor import Predictor, load
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset

CASES = ((4, 1.0), (4, 0.3), (4, 0.1), (4, 0.03), (8, 1.0), (8, 0.1), (12, 1.0), (12, 0.1), (16, 1.0))
QUIET = ("shot noise", "dark noise", "converter", "full well", "fixed pattern", "drift")


def main() -> None:
    """Print a table by phase steps and part of the error that is left."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensor", default="mlx75027", help="name in data/sensors or TOML file")
    parser.add_argument("--scenes", type=int, default=24, help="test scenes, default 24")
    given = parser.parse_args()
    predictor, dataset = load(given.run), open_dataset(given.dataset)
    scenes = dataset.ids("test")[: given.scenes]
    quiet = replace(without(load_sensor(given.sensor), *QUIET), highest_harmonic=33)
    print(f"{len(scenes)} test scenes\n")
    print("| phase steps | left % | largest phase error, mrad | MAE cm | mIoU | object MAE cm ", end="")
    print("| with a capture: MAE cm | mIoU | object MAE cm |\n|---|---|---|---|---|---|---|---|---|")
    for steps, left in CASES:
        sensor = replace(quiet, phase_steps=steps, wiggling_left=left)
        alone, captured = judged(predictor, dataset, scenes, sensor)
        error = 1e3 * largest_error_rad(sensor, predictor.config.inputs.frequencies_hz)
        print(f"| {steps} | {100 * left:g} | {error:.2g} | {cells(alone)} | {cells(captured)} |", flush=True)


def largest_error_rad(sensor: SensorSettings, frequencies_hz: Sequence[float]) -> float:
    """Largest phase error over all phases and frequencies, radians."""
    phases = np.exp(1j * np.linspace(0, 2 * np.pi, 4 * 3 * 361))
    light = np.repeat(phases.reshape(3, -1)[..., None], len(frequencies_hz), axis=-1)
    flat = replace(sensor, vignetting=0.0, scattering=0.0, crosstalk=0.0, width=light.shape[1], height=3)
    seen = BinnedCamera(flat, frequencies_hz, light.shape[1], 3).mean(light)
    return float(np.abs(np.angle(seen / light)).max())


def judged(
    predictor: Predictor, dataset: Dataset, scenes: Sequence[str], sensor: SensorSettings
) -> tuple[Summary, Summary]:
    """Metrics of the scenes without and with a capture of the empty corner."""
    config = predictor.config
    camera = BinnedCamera(sensor, config.inputs.frequencies_hz, config.image_width, config.image_height)
    used = config.inputs.places(dataset.preset.itof.frequencies_hz)
    metrics: tuple[list, list] = ([], [])
    for scene in scenes:
        folder = dataset.render_folder(scene)
        image, truth = read_image(folder / MEASUREMENT_FILE), DepthMap.read(folder / GROUND_TRUTH_FILE)
        seen, corner = (camera.mean(image.phasors(part)[0][..., used]) for part in ("itof", "direct"))
        for each, reference in zip(metrics, (None, corner), strict=True):
            found = predictor.predict(seen, reference)
            each.append(image_metrics(found.radial_depth_m, found.mask, truth.radial_depth_m, truth.mask))
    return summarise(metrics[0]), summarise(metrics[1])


if __name__ == "__main__":
    main()
