"""Findings about good measurements: of random corners, and as the cameras of data/sensors see them.

The wall of a camera whose waves are not calibrated is rightly called not flat; such findings count as well,
by their code. A finding that refuses ends with an exclamation mark. Run:

    .venv/bin/python benchmarks/false_alarms.py
"""

import argparse
from collections import Counter
from collections.abc import Iterator

import numpy as np

from itof.arrays import Phasors
from itof.capture.image_check import check_image
from itof.sensor.camera import Camera
from itof.sensor.cameras import load_sensor
from model.settings.fresh import FreshScenes
from render.batch.light import BatchedLight
from scenegen import load_preset

SETS_HZ = ((20e6, 50e6, 60e6), (40e6, 70e6))
NOISES = (0.0, 3e-4, 1e-3, 1e-2)  # of a pixel's amplitude
SENSORS = ("calibrated", "sixteen-steps", "opt8241", "mlx75027")
AT_ONCE = 20


def main() -> None:
    """Print how many measurements have which findings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="scenes for each set of frequencies")
    parser.add_argument("--sensor-count", type=int, default=10, help="of them that each camera sees")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    for frequencies_hz in SETS_HZ:
        images = list(corners(given.count, given.seed, frequencies_hz))
        for noise in NOISES:
            spoilt = [
                (
                    z * (1 + noise * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))),
                    fov_deg,
                )
                for z, fov_deg in images
            ]
            tell(f"noise {noise:g}", spoilt, frequencies_hz)
        for name in SENSORS:
            camera = Camera(load_sensor(name), frequencies_hz)
            seen = [(camera.capture(z, rng).phasor, fov_deg) for z, fov_deg in images[: given.sensor_count]]
            tell(name, seen, frequencies_hz)


def corners(count: int, seed: int, frequencies_hz: tuple[float, ...]) -> Iterator[tuple[Phasors, float]]:
    """Images of 80 x 60 pixels of random corners, and their fields of view, degrees."""
    scenes = FreshScenes(load_preset("judge-any-corner")).with_seed(seed)
    light = BatchedLight(frequencies_hz, 80, 60, error=0.05)
    for start in range(0, count, AT_ONCE):
        some = [scenes.scene(index, {}) for index in range(start, min(start + AT_ONCE, count))]
        images = light.images(some)
        for scene, direct, hidden in zip(some, images.direct, images.hidden, strict=True):
            yield (direct + hidden).astype(np.complex128), scene.camera.horizontal_fov_deg


def tell(name: str, images: list[tuple[Phasors, float]], frequencies_hz: tuple[float, ...]) -> None:
    """Print the findings about images."""
    codes = Counter(
        finding.code + "!" * finding.refused
        for z, fov_deg in images
        for finding in check_image(z, frequencies_hz, fov_deg).findings
    )
    mhz = ", ".join(f"{each / 1e6:g}" for each in frequencies_hz)
    print(f"{mhz} MHz, {name}: {len(images)} images, {dict(codes)}", flush=True)


if __name__ == "__main__":
    main()
