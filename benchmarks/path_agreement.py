"""Compare ``many-light`` with the path tracer on scenes of all classes: image sums and single pixels.

Many independent renders give the mean and the noise of the path tracer. ``many-light`` renders with an error
of 0.1 %. The ratio of image sums should be 1 within both. The mean square of (pixel difference / noise)
should be 1. Run:

    .venv/bin/python benchmarks/path_agreement.py
"""

import argparse

import numpy as np
from seven_scenes import seven_scenes

from itof import MeasurementMatrix, TransientLayout
from render.backend import select_variant
from render.options import ManyLightOptions, PathOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.path_tracer import PathTracer
from render.transport.scene_loading import load_scene

HZ = (20e6, 50e6, 60e6)
ERROR = 0.001  # of many-light


def main() -> None:
    """Print a line per scene and frequency."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--runs", type=int, default=48)
    arguments.add_argument("--spp", type=int, default=4096)
    given = arguments.parse_args()
    layout = TransientLayout(24, 18, 2000, 0.01, 0.0)
    phi = MeasurementMatrix(HZ, layout.bin_count, layout.bin_width_m, splat="quadratic")
    variant = select_variant()

    print(f"{given.runs} renders of {given.spp} paths per pixel, 24 x 18 pixels")
    print("scene                 MHz   path / many-light    sigma   many-light's error   mean square z")
    with seven_scenes() as scenes:
        for name, dataset, scene_id in scenes:
            scene = load_scene(dataset, scene_id)
            method = ManyLight(ManyLightOptions(error=ERROR), variant)
            image = method.expose(scene, View(layout, HZ, 3, 1)).phasors()
            tracer = PathTracer(PathOptions(spp=given.spp), variant)
            runs = np.array(
                [
                    phi.apply_streaming(tracer.expose(scene, View(layout, HZ, 3, seed)).row_blocks())
                    for seed in range(given.runs)
                ]
            )
            hidden = runs - image.direct  # (runs, H, W, F)
            sums = hidden.sum(axis=(1, 2)) / image.hidden.sum(axis=(0, 1))
            sigma = sums.real.std(axis=0, ddof=1) / np.sqrt(given.runs)
            noise = (hidden.real.var(axis=0, ddof=1) + hidden.imag.var(axis=0, ddof=1)) / given.runs
            squared = np.abs(hidden.mean(axis=0) - image.hidden) ** 2
            scatter = squared.sum(axis=(0, 1)) / noise.sum(axis=(0, 1))
            for index, frequency_hz in enumerate(HZ):
                ratio = sums.real.mean(axis=0)[index]
                print(
                    f"{name:<20} {frequency_hz / 1e6:4.0f} {ratio:19.4f} {sigma[index]:8.4f}"
                    f" {image.error:20.4f} {scatter[index]:15.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
