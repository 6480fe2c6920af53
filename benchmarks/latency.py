"""Time from the phasors of one image to its depth map: milliseconds, and frames per second.

One call of `Predictor.predict` with one image is measured: from phasors in memory to depth map, mask and
phasor in memory. It contains the input channels (on the CPU), the network, the readout, and the way to the
device and back. The direct return of the wall is computed once, before. Frames per second are 1000 / median.

The time does not depend on what a network has learnt, so without --run the network of a training preset is
measured as it is before training. A run is measured at the image size of its training.

Run:

    .venv/bin/python benchmarks/latency.py
    .venv/bin/python benchmarks/latency.py --run run80 --device cpu
"""

import argparse
import os
import platform
import time

import numpy as np
import torch
from numpy.typing import NDArray

import model
from itof import phase_per_metre
from itof.wall.wall_view import WallView
from model.device import choose_device
from model.network.channels import InputSpec
from model.prediction.predictor import Predictor
from model.run_folder.run_config import RunConfig

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
VIEW = WallView(60.0, ((1, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0), (0, 0, 2), (0, 0, -1))
OBJECT_DEPTH_M = (2.6, 0.2)  # mean and standard deviation, about as in the preset `paper`
SIZES = ("320x240", "80x60")
WARM_UP = 5  # calls before the measurement: libraries choose and compile kernels, memory is taken
LEAST_CALLS = 20  # for the 95th percentile


def main() -> None:
    """Print a table with one line for each network, image size and device."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--run", help="run folder of a trained network")
    which.add_argument("--preset", default="default", help="training preset, default: default")
    parser.add_argument(
        "--size", action="append", help="image size, not with --run; default 320x240 and 80x60"
    )
    parser.add_argument(
        "--device", choices=["cpu", "cuda"], action="append", help="default: cpu, and cuda if there is one"
    )
    parser.add_argument("--seconds", type=float, default=20.0, help="least time of a measurement, default 20")
    given = parser.parse_args()
    if given.run and given.size:
        parser.error("a run has the image size of its training: leave --size out")
    devices = given.device or ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
    busy = f"load {os.getloadavg()[0]:.1f} before the start" if hasattr(os, "getloadavg") else ""
    print(f"{torch.get_num_threads()} threads of {os.cpu_count()} cores, {busy}, PyTorch {torch.__version__}")
    print("| network | size | device | calls | median, ms | 95th percentile, ms | frames/s |")
    print("|---|---|---|---|---|---|---|")
    for device in devices:
        for name, predictor in predictors(given, device):
            times_ms = latencies_ms(predictor, given.seconds)
            median, late = np.quantile(times_ms, [0.5, 0.95])
            size = f"{predictor.config.image_width} x {predictor.config.image_height}"
            print(
                f"| {name} | {size} | {named(device)} | {len(times_ms)} | {median:.1f} | {late:.1f} | "
                f"{1000 / median:.1f} |",
                flush=True,
            )


def predictors(given: argparse.Namespace, device: str) -> list[tuple[str, Predictor]]:
    """The networks to measure on a device, with their names."""
    if given.run:
        return [("run", model.load(given.run, device))]
    return [
        (f"preset {given.preset}, untrained", untrained(given.preset, *map(int, size.split("x")), device))
        for size in given.size or SIZES
    ]


def untrained(preset: str, width: int, height: int, device: str) -> Predictor:
    """The network of a training preset with initial weights, for images of one size."""
    settings = model.settings_from_dict(*model.training_preset(preset)).for_images(width)
    kind = settings.input.channels.kind
    frequencies_hz = settings.input.frequencies_hz or FREQUENCIES_HZ
    residuals = 2 * len(frequencies_hz) - 1 if "residual" in kind else 0
    scales = (1e-3,) * residuals
    inputs = InputSpec(kind, frequencies_hz, 1.0, scales, "measured", settings.input.reference)
    config = RunConfig(
        *(settings, inputs, frequencies_hz[0], VIEW, width, height, "", "", "", "0" * 64),
        background_per_object=30.0,
        object_depth_m=OBJECT_DEPTH_M if settings.predicts_probability else None,
    )
    chosen = choose_device(device)
    network = config.network(torch.Generator().manual_seed(0)).to(chosen)
    return Predictor(config, network, chosen, weights_sha256="0" * 64)


def latencies_ms(predictor: Predictor, seconds: float) -> NDArray[np.float64]:
    """(n,) milliseconds of single predictions, one after the other, for at least `seconds`."""
    image = measurement(predictor)
    for _ in range(WARM_UP):
        predictor.predict(image)
    times_ms: list[float] = []
    started = time.perf_counter()
    while len(times_ms) < LEAST_CALLS or time.perf_counter() - started < seconds:
        before = time.perf_counter()
        predictor.predict(image)  # its results are numpy arrays, so the device has finished
        times_ms.append(1000 * (time.perf_counter() - before))
    return np.array(times_ms)


def measurement(predictor: Predictor) -> NDArray[np.complex64]:
    """(H, W, F) phasors: the direct return of the wall and 0.2 % of hidden light."""
    frequencies_hz = predictor.config.inputs.frequencies_hz
    direct = predictor.reference  # (H, W, F); computed here, before the measurement
    opl_m = np.random.default_rng(0).uniform(6, 9, (*direct.shape[:2], 1))
    hidden = 2e-3 * np.abs(direct) * np.exp(1j * opl_m * phase_per_metre(frequencies_hz))
    return (direct + hidden).astype(np.complex64)


def named(device: str) -> str:
    """The device in words."""
    return torch.cuda.get_device_name() if device == "cuda" else f"CPU ({platform.machine()})"


if __name__ == "__main__":
    main()
