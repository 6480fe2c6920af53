r"""Raw frames of rendered scenes, as a camera gives them of which the reader knows little.

The camera is one of data/sensors (or a TOML file), but its fixed pattern, rise time, duty cycle, contrast and
scattering are its own, drawn from a seed. For each scene there are three files of raw frames: of the corner
(frames.npz), of the empty corner (empty.npz), and of a mirror on the relay wall (mirror.npz), in which
everything but the object is a room 6.5 m away. camera.toml is the sidecar: what a data sheet would say. Run:

    .venv/bin/python benchmarks/raw_frames.py DATASET raw --sensor sixteen-steps --scenes 5
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from itof import DepthMap, phasor_of_return, read_image
from itof.sensor.camera import Camera
from itof.sensor.cameras import load_sensor
from itof.sensor.random_camera import random_camera
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset

ROOM_M = 6.5  # what the mirror shows beside the object
LARGEST_SCATTERING = 0.005  # of the lens; its own is between 0 and this
SIDECAR = """layout = "taps"
arrays = ["raw"]
axes = ["frame", "frequency", "step", "tap", "row", "column"]
frequencies_hz = {frequencies_hz}
horizontal_fov_deg = {sensor.horizontal_fov_deg}
step_count = {sensor.phase_steps}
tap_count = 2
bits = {sensor.adc_bits}
saturation_dn = {saturation}
"""


def main() -> None:
    """Write the folders of some scenes and the sidecar."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("--sensor", default="sixteen-steps", help="name in data/sensors or TOML file")
    parser.add_argument("--split", default="test", help="of the scenes, default test")
    parser.add_argument("--scenes", type=int, default=5, help="the first so many scenes, default 5")
    parser.add_argument("--frames", type=int, default=2, help="measurements of the corner, default 2")
    parser.add_argument("--corner-frames", type=int, default=4, help="measurements of the empty corner")
    parser.add_argument("--seed", type=int, default=0, help="of the camera and of its noise")
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    sensor = replace(load_sensor(given.sensor), scattering=LARGEST_SCATTERING)
    sensor = random_camera(sensor, np.random.default_rng([given.seed, 1]))
    frequencies_hz = dataset.preset.itof.frequencies_hz
    given.out.mkdir(parents=True)
    saturation = int(0.97 * (sensor.full_well_e / sensor.adc_e_per_dn + sensor.adc_offset_dn))
    text = SIDECAR.format(sensor=sensor, frequencies_hz=list(frequencies_hz), saturation=saturation)
    (given.out / "camera.toml").write_text(text)
    for place, scene in enumerate(dataset.ids(given.split)[: given.scenes]):
        rng = np.random.default_rng([given.seed, 2, place])
        folder = given.out / scene
        folder.mkdir()
        parts = light_of(dataset, scene)
        for name, light in zip(("frames", "empty", "mirror"), parts, strict=True):
            frames = {"frames": given.frames, "empty": given.corner_frames, "mirror": 1}[name]
            camera = Camera(replace(sensor, frames=frames), frequencies_hz)
            np.savez(folder / f"{name}.npz", raw=camera.raw_frames(light, rng).astype(np.uint16))
        print(folder, flush=True)


def light_of(dataset: Dataset, scene: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(H, W, F) phasors of the corner, of the empty corner, and of a mirror in it."""
    folder, frequencies_hz = dataset.render_folder(scene), dataset.preset.itof.frequencies_hz
    image, truth = read_image(folder / MEASUREMENT_FILE), DepthMap.read(folder / GROUND_TRUTH_FILE)
    corner, empty = image.phasors()[0], image.phasors("direct")[0]
    depth_m = np.where(truth.mask, truth.radial_depth_m, ROOM_M)
    strength = np.abs(empty[..., 0]).mean() * (2.5 / depth_m) ** 2
    mirror = np.stack([strength * phasor_of_return(depth_m, f) for f in frequencies_hz], axis=-1)
    return corner, empty, mirror


if __name__ == "__main__":
    main()
