r"""How long a camera must expose, and which of its imperfections hurts.

The test scenes are measured by a camera of data/sensors (or a TOML file) at several integration times of a
raw frame, and predicted. With --each, the same at one integration time, with every imperfection of the camera
alone and with all but this one. A measurement has a raw frame for each phase step, frequency and averaged
frame; the total is the time for all of them. With --capture N, the network gets the empty corner as the same
camera measures it in N frames; it divides by it, so what camera and wall do to direct light cancels. Run:

    .venv/bin/python benchmarks/exposure.py night-80x60 new80 --sensor mlx75027 --without wiggling
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from ablations import cells

from itof import DepthMap, read_image
from itof.sensor.camera import Camera, phase_noise_rad
from itof.sensor.settings import SensorSettings
from model.network.metrics import Summary, image_metrics, summarise
from model.prediction.predictor import Predictor, load
from model.sensors import load_sensor
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset

# Imperfections by name: the settings that switch one off.
PERFECT: dict[str, dict[str, object]] = {
    "shot noise": {"shot_noise": False},
    "dark noise": {"read_noise_e": 0.0, "dark_current_e_s": 0.0},
    "ambient light": {"ambient_w_m2": 0.0},
    "converter": {"adc_bits": None, "adc_e_per_dn": None},
    "full well": {"full_well_e": None},
    "fixed pattern": {
        "gain_spread": 0.0,
        "offset_spread_e": 0.0,
        "dead_pixels": 0.0,
        "tap_mismatch": 0.0,
    },
    "wiggling": {"emitter_waveform": "sinusoidal", "reference_waveform": "sinusoidal"},
    "vignetting": {"vignetting": 0.0},
    "scattering": {"scattering": 0.0},
    "drift": {"phase_drift_rad": 0.0},
}


def main() -> None:
    """Print a table by integration time, or by imperfection."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensor", default="mlx75027", help="name in data/sensors or TOML file")
    parser.add_argument(
        "--milliseconds", type=float, nargs="+", default=[0.03, 0.1, 0.3, 1, 3], help="of a raw frame"
    )
    parser.add_argument("--frames", type=int, default=1, help="measurements that are averaged")
    parser.add_argument("--scenes", type=int, default=40, help="test scenes, default 40")
    parser.add_argument(
        "--without", choices=PERFECT, nargs="*", default=[], help="imperfections to leave out"
    )
    parser.add_argument("--each", action="store_true", help="every imperfection alone, at the last time")
    parser.add_argument(
        "--wiggling-left", type=float, help="part of the wiggling that the calibration leaves"
    )
    parser.add_argument("--capture", type=int, default=0, help="frames of a capture of the empty corner")
    given = parser.parse_args()
    predictor, dataset = load(given.run), open_dataset(given.dataset)
    scenes = dataset.ids("test")[: given.scenes]
    width, height = predictor.config.image_width, predictor.config.image_height
    sensor = replace(load_sensor(given.sensor), frames=given.frames)
    if given.wiggling_left is not None:
        sensor = replace(sensor, wiggling_left=given.wiggling_left)
    for name in given.without:
        sensor = replace(sensor, **PERFECT[name])
    print(f"{len(scenes)} test scenes, {width} x {height} pixels\n")
    if given.each:
        print("| camera | MAE cm | mIoU | object MAE cm |\n|---|---|---|---|")
        chosen = replace(sensor, integration_s=given.milliseconds[-1] / 1e3)
        for name, camera in imperfections(chosen):
            print(
                f"| {name} | {cells(measured(predictor, dataset, scenes, camera, given.capture)[0])} |",
                flush=True,
            )
        return
    print(
        "| raw frame, ms | all frames, s | electrons | noise of a pixel, mrad | saturated % | MAE cm | mIoU "
        "| object MAE cm |\n|---|---|---|---|---|---|---|---|"
    )
    for milliseconds in given.milliseconds:
        camera = replace(sensor, integration_s=milliseconds / 1e3)
        summary, electrons, saturated = measured(predictor, dataset, scenes, camera, given.capture)
        frequencies_hz = predictor.config.inputs.frequencies_hz
        total_s = camera.integration_s * camera.phase_steps * camera.frames * len(frequencies_hz)
        pixels = camera.binning(width, height) ** 2 * camera.frames
        noise = 1e3 * phase_noise_rad(camera, electrons, frequencies_hz[-1]) / pixels**0.5
        print(
            f"| {milliseconds:g} | {total_s:.3g} | {electrons:.3g} | {noise:.3g} | {100 * saturated:.1f} "
            f"| {cells(summary)} |",
            flush=True,
        )


def imperfections(sensor: SensorSettings) -> Iterator[tuple[str, SensorSettings]]:
    """The whole camera, a perfect one, and a perfect one with each imperfection that the camera has."""
    perfect = replace(sensor, **{key: value for each in PERFECT.values() for key, value in each.items()})
    yield "all", sensor
    yield "perfect", perfect
    for name, keys in PERFECT.items():
        alone = replace(perfect, **{key: getattr(sensor, key) for key in keys})
        if alone != perfect:
            yield f"{name} alone", alone
            yield f"all but {name}", replace(sensor, **keys)


def measured(
    predictor: Predictor, dataset: Dataset, scenes: Sequence[str], sensor: SensorSettings, captured: int
) -> tuple[Summary, float, float]:
    """Metrics of the scenes as the camera measures them, median electrons of a pixel, part saturated."""
    camera = Camera(sensor, predictor.config.inputs.frequencies_hz)
    empty = Camera(replace(sensor, frames=captured or 1), predictor.config.inputs.frequencies_hz)
    places = predictor.config.inputs.places(dataset.preset.itof.frequencies_hz)
    rng, metrics, electrons, saturated = np.random.default_rng(0), [], [], []
    for scene in scenes:
        image = read_image(dataset.render_folder(scene) / MEASUREMENT_FILE)
        truth = DepthMap.read(dataset.render_folder(scene) / GROUND_TRUTH_FILE)
        seen = camera.capture(image.phasors()[0][..., places], rng)
        corner = empty.capture(image.phasors("direct")[0][..., places], rng).phasor if captured else None
        found = predictor.predict(seen.phasor, corner)
        metrics.append(image_metrics(found.radial_depth_m, found.mask, truth.radial_depth_m, truth.mask))
        electrons.append(float(np.median(seen.signal_e)))
        saturated.append(float(seen.saturated.mean()))
    return summarise(metrics), float(np.mean(electrons)), float(np.mean(saturated))


if __name__ == "__main__":
    main()
