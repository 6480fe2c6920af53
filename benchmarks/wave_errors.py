"""The error of a network behind a camera without noise, by its waves, phase steps and calibration.

The test scenes are measured by the camera `mlx75027`, which has square waves, and by `measured-waves`. Each
is predicted as it is, and with a capture of the empty corner by the same camera. Run:

    .venv/bin/python benchmarks/wave_errors.py night-80x60 new80
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from itof import DepthMap, read_image
from itof.metrics import Summary, image_metrics, summarise
from itof.sensor.binned import BinnedCamera
from itof.sensor.cameras import load_sensor
from itof.sensor.imperfections import PERFECT, without
from itof.sensor.settings import SensorSettings
from model.prediction.predictor import Predictor, load
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset

CASES = ((4, 1.0), (4, 0.1), (4, 0.03), (8, 1.0), (8, 0.1), (16, 1.0), (16, 0.0))
CAMERAS = {"square": "mlx75027", "measured": "measured-waves"}


def main() -> None:
    """Print a table by waves, phase steps and part of the error that is left."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=24, help="test scenes, default 24")
    given = parser.parse_args()
    predictor, dataset = load(given.run), open_dataset(given.dataset)
    scenes, hz = dataset.ids("test")[: given.scenes], predictor.config.inputs.frequencies_hz
    print("| phase steps | error left, % | waves | phase errors, mrad | alone: MAE cm | captured: MAE cm |")
    print("|---|---|---|---|---|---|")
    for steps, left in CASES:
        for waves, name in CAMERAS.items():
            quiet = without(load_sensor(name), *({*PERFECT} - {"wiggling", "vignetting"}))
            sensor = replace(quiet, highest_harmonic=33, phase_steps=steps, wiggling_left=left)
            errors = ", ".join(f"{1e3 * largest_error_rad(sensor, each):.2g}" for each in hz)
            found = (
                f"{100 * each.depth_mae_m.mean:.2f}" for each in judged(predictor, dataset, scenes, sensor)
            )
            print(f"| {steps} | {100 * left:g} | {waves} | {errors} | {' | '.join(found)} |", flush=True)


def largest_error_rad(sensor: SensorSettings, frequency_hz: float) -> float:
    """Largest error of the phase at a frequency, over all phases, radians."""
    light = np.exp(1j * np.linspace(0, 2 * np.pi, 4 * 3 * 361)).reshape(3, -1, 1)
    flat = replace(sensor, vignetting=0.0, width=light.shape[1], height=3)
    seen = BinnedCamera(flat, [frequency_hz], light.shape[1], 3).mean(light)
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
