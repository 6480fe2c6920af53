"""How much light of more than three bounces adds to the hidden signal, for one scene of each class.

Light that meets at most N surfaces is rendered with N = 3 and with larger N, by both methods. What the larger
N adds is relative to the hidden signal of three bounces: its norm over the image, and the mean phase by which
it turns the signal. A seed gives the path tracer the same paths for every N, so the difference of two renders
has no noise of the direct return and of three bounces. Norms are free of noise in the mean: they come from
products of different seeds. Standard errors are by jackknife over the seeds. Run:

    .venv/bin/python benchmarks/bounces.py
"""

import argparse
import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from seven_scenes import seven_scenes

from itof import MeasurementMatrix, TransientLayout
from render.backend import select_variant
from render.options import ManyLightOptions, PathOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.path_tracer import PathTracer
from render.transport.scene_loading import load_scene

HZ = (20e6, 50e6, 60e6)
Phasors = NDArray[np.complex128]  # (seeds, H, W, F) or (H, W, F)


def main() -> None:
    """Print a line per scene, number of bounces and method."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--bounces", type=int, nargs="+", default=[4, 6])
    arguments.add_argument("--seeds", type=int, default=8, help="renders of each kind, 3 or more; default 8")
    arguments.add_argument("--spp", type=int, default=2048, help="paths per pixel of a render, default 2048")
    arguments.add_argument("--lights", type=int, default=1024, help="of a render, default 1024")
    given = arguments.parse_args()
    if given.seeds < 3:
        arguments.error("the errors need at least three seeds")
    layout = TransientLayout(40, 30, 2000, 0.01, 0.0)
    phi = MeasurementMatrix(HZ, layout.bin_count, layout.bin_width_m, splat="quadratic")
    variant = select_variant()
    tracer = PathTracer(PathOptions(spp=given.spp), variant)
    lights = ManyLight(ManyLightOptions(lights=given.lights), variant)

    print(f"{given.seeds} seeds, 40 x 30 pixels, {given.spp} paths per pixel, {given.lights} lights")
    print("| scene (roughness) | N | method | added, % at 20, 50, 60 MHz | phase, mrad at 20, 50, 60 MHz |")
    print("|---|---|---|---|---|")
    with seven_scenes() as scenes:
        for name, dataset, scene_id in scenes:
            scene = load_scene(dataset, scene_id)

            def traced(bounces: int, seed: int, scene=scene) -> Phasors:
                view = View(layout, HZ, bounces, seed)
                return phi.apply_streaming(tracer.expose(scene, view).row_blocks())

            def lit(bounces: int, seed: int, scene=scene) -> Phasors:
                return lights.expose(scene, View(layout, HZ, bounces, seed)).phasors().hidden

            hidden = np.mean([lit(3, seed) for seed in range(given.seeds)], axis=0)
            for method, render in (("path", traced), ("many-light", lit)):
                for bounces, added in additions(render, given.bounces, given.seeds).items():
                    share, turn = with_errors(functools.partial(relative, hidden), added)
                    print(
                        f"| {name} | {bounces} | {method} | {cell(100 * share)} | {cell(1e3 * turn)} |",
                        flush=True,
                    )


def additions(render: Callable[[int, int], Phasors], bounces: list[int], seeds: int) -> dict[int, Phasors]:
    """(seeds, H, W, F) what each number of bounces adds to three."""
    found: dict[int, list[Phasors]] = {number: [] for number in bounces}
    for seed in range(seeds):
        three = render(3, seed)
        for number in bounces:
            found[number].append(render(number, seed) - three)
    return {number: np.array(runs) for number, runs in found.items()}


def relative(hidden: Phasors, added: Phasors) -> NDArray[np.float64]:
    """(2, F) norm of the mean of `added` relative to `hidden`, and the mean phase that it adds, rad.

    The square of the norm is the mean product of different seeds, in which noise cancels. It can be below
    zero where there is nothing but noise; the root then keeps the sign.
    """
    count = len(added)
    every = (np.abs(added.sum(axis=0)) ** 2).sum(axis=(0, 1))
    same = (np.abs(added) ** 2).sum(axis=(0, 1, 2))
    square = (every - same) / (count * (count - 1)) / (np.abs(hidden) ** 2).sum(axis=(0, 1))  # (F,)
    product = (hidden.conj() * (hidden + added.mean(axis=0))).sum(axis=(0, 1))
    return np.stack([np.sign(square) * np.sqrt(np.abs(square)), np.angle(product)])


def with_errors(of: Callable[[Phasors], NDArray[np.float64]], runs: Phasors) -> NDArray[np.float64]:
    """(2, F, 2) a figure of all runs, and its standard error by jackknife (Tukey 1958)."""
    without = np.array([of(np.delete(runs, index, axis=0)) for index in range(len(runs))])
    error = np.sqrt((len(runs) - 1) * without.var(axis=0))
    return np.stack([of(runs), error], axis=-1)


def cell(values: NDArray[np.float64]) -> str:
    """The values of all frequencies with their standard errors."""
    rounded = np.round(values, 2) + 0.0  # no -0
    return ", ".join(f"{value:.2f} ± {error:.2f}" for value, error in rounded)


if __name__ == "__main__":
    main()
