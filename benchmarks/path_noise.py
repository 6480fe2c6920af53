"""Noise of the path tracer on the hidden signal, and paths per second.

Renders a few scenes twice with different seeds. Half the squared difference is the variance. The error is
relative to the hidden signal (a long render minus its one-bounce part), not to the total. Run:

    .venv/bin/python benchmarks/path_noise.py
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from itof import TransientLayout, phasors
from render.backend import select_variant
from render.options import PathOptions
from render.transport.method import View
from render.transport.path_tracer import PathTracer
from render.transport.scene_loading import load_scene
from scenegen import preset_from_dict
from scenegen.making.blender import BlenderMaker
from scenegen.making.generation import generate

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
REFERENCE_SPP = 16384  # the noise of this render, 8 to 11 %, changes the norm by about 0.5 %


def main() -> None:
    """Print a table of noise against paths per pixel."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--width", type=int, default=40)
    arguments.add_argument("--scenes", type=int, default=3)
    arguments.add_argument("--spp", type=int, nargs="+", default=[256, 1024, 4096, 16384])
    given = arguments.parse_args()
    height = given.width * 3 // 4
    layout = TransientLayout(given.width, height, 1500, 0.01, 0.0)
    variant = select_variant()

    with tempfile.TemporaryDirectory() as folder:
        preset = preset_from_dict({"dataset": {"count": given.scenes}}, "benchmark")
        dataset = generate(Path(folder) / "data", preset, BlenderMaker(), lambda: None)
        print(f"{given.width} x {height} pixels, {variant}; error per pixel relative to the hidden signal")
        print("scene   class            spp   20 MHz   50 MHz   60 MHz  x sqrt(spp)   Mpaths/s")
        for scene_id in dataset.ids():
            scene = load_scene(dataset, scene_id)

            def measure(spp, seed, bounces=3, scene=scene):
                started = time.perf_counter()
                view = View(layout, FREQUENCIES_HZ, bounces, seed)
                blocks = list(PathTracer(PathOptions(spp=spp), variant).expose(scene, view).row_blocks())
                seconds = time.perf_counter() - started
                return phasors(np.concatenate(blocks), FREQUENCIES_HZ, layout.bin_width_m), seconds

            hidden = measure(REFERENCE_SPP, 10)[0] - measure(REFERENCE_SPP // 16, 11, bounces=1)[0]
            norm = np.sqrt(np.mean(np.abs(hidden) ** 2, axis=(0, 1)))  # (F,)
            for spp in given.spp:
                (a, _), (b, seconds) = measure(spp, 1), measure(spp, 2)
                variance = np.mean(np.abs(a - b) ** 2, axis=(0, 1)) / 2
                error = np.sqrt(variance) / norm
                rate = given.width * height * spp / seconds / 1e6
                name = dataset.entry(scene_id).object_class
                columns = "".join(f"{value:9.3f}" for value in error)
                print(f"{scene_id}  {name:<14} {spp:6d}{columns}{error[0] * np.sqrt(spp):13.1f}{rate:11.1f}")


if __name__ == "__main__":
    main()
