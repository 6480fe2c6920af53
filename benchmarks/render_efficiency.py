"""Time at equal error of ``many-light`` and of mitransient's own ``transient_path``, in one run.

Both methods measure seven scenes at 60 MHz. Their errors are true errors, relative to the hidden signal,
against one reference (16 times the lights of ``many-light``, other seeds, no lattice).

- many-light renders with --error, so its time includes the trials that find the number of lights. Its error
  is the root mean square over three seeds, with everything that is wrong: lights, lattice, the reference.
- transient_path has a bias from box bins and from paths that start at the near clip plane. It is as large as
  the hidden signal, and no number of paths lowers it. The errors of independent seeds share only the bias,
  so the mean product of two of them is the square of the bias. The rest is noise, and only the noise counts
  in the ratio. This favours transient_path.

The ratio is error² x seconds of transient_path over that of many-light: how many times as long
transient_path takes for the same error, because its error² x seconds is the same for any number of paths.
The first of the seeds compiles the kernels, so its time does not count. Run:

    .venv/bin/python benchmarks/render_efficiency.py
"""

import argparse
import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reference_light import Reference, reference
from seven_scenes import SCENES, seven_scenes

from itof import TransientLayout, phasors
from render.backend import select_variant
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import PhasorImage, View
from render.transport.scene_loading import load_scene

HZ = (60e6,)
SEEDS = 3


def main() -> None:
    """Print a table for each size."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--size", nargs="+", default=["80x60", "320x240"], help="80x60 and 320x240")
    arguments.add_argument("--error", type=float, default=0.005, help="of many-light, default 0.005")
    arguments.add_argument("--paths", type=float, default=20e6, help="of an image of transient_path")
    arguments.add_argument("--pixels", type=int, default=4096, help="most pixels that are compared")
    arguments.add_argument("--scene", nargs="+", default=[], choices=[name for name, _ in SCENES])
    given = arguments.parse_args()
    variant = select_variant()
    with seven_scenes(tuple(given.scene)) as scenes:
        for size in given.size:
            width, height = map(int, size.split("x"))
            layout = TransientLayout(width, height, 1500, 0.01, 0.0)
            spp = max(1, round(given.paths / (width * height)))
            print(f"\n{size} pixels, {variant}, `--error {given.error:g}`, transient_path with {spp} spp\n")
            print(
                "| scene | lights | reported error | true error | seconds | transient_path: error | of which "
                "bias | of which noise | seconds | ratio |\n|---|---|---|---|---|---|---|---|---|---|"
            )
            for name, dataset, scene_id in scenes:
                scene = load_scene(dataset, scene_id)
                print(f"| {name} {columns(scene, layout, variant, spp, given)}", flush=True)


def columns(scene: Any, layout: TransientLayout, variant: str, spp: int, given: argparse.Namespace) -> str:
    """The columns of a scene."""

    def many_light(seed: int) -> tuple[PhasorImage, int]:
        exposure = ManyLight(ManyLightOptions(error=given.error), variant).expose(scene, view(layout, seed))
        return exposure.phasors(), int(exposure.attributes["lights"])

    made, seconds = timed(many_light)
    lights = max(count for _, count in made)
    truth = reference(scene, view(layout, 0), lights, given.pixels)
    square, _ = mean_squares([truth.of(image.hidden) - truth.values for image, _ in made], truth)
    stock, stock_seconds = timed(lambda seed: stock_transient_path(scene, layout, spp, seed))
    total = truth.of(made[0][0].direct) + truth.values
    stock_square, bias_square = mean_squares([truth.of(image) - total for image in stock], truth)
    noise_square = stock_square - bias_square
    reported = np.mean([image.error for image, _ in made])
    ratio = noise_square * stock_seconds / (square * seconds)
    bias, noise = np.sqrt(max(bias_square, 0)), np.sqrt(noise_square)
    return (
        f"| {lights} | {reported:.2%} | {np.sqrt(square):.2%} | {seconds:.2f} | {np.sqrt(stock_square):.1%} "
        f"| {bias:.1%} | {noise:.1%} | {stock_seconds:.1f} | {ratio:,.0f} |"
    )


def view(layout: TransientLayout, seed: int) -> View:
    """A measurement at 60 MHz."""
    return View(layout, HZ, 3, seed)


def timed(render: Callable[[int], Any]) -> tuple[list[Any], float]:
    """Results of a few seeds, and the mean seconds of all but the first."""
    results = [render(0)]
    started = time.perf_counter()
    results += [render(seed) for seed in range(1, SEEDS)]
    return results, (time.perf_counter() - started) / (SEEDS - 1)


def mean_squares(missed: list[NDArray[np.complex128]], truth: Reference) -> tuple[float, float]:
    """Mean square of relative errors, and the part of it that independent seeds share."""
    norm = np.linalg.norm(truth.values) ** 2
    square = np.mean([np.linalg.norm(error) ** 2 for error in missed])
    shared = np.mean([np.vdot(a, b).real for a, b in itertools.combinations(missed, 2)])
    return float(square / norm), float(shared / norm)


def stock_transient_path(scene: Any, layout: TransientLayout, spp: int, seed: int) -> NDArray[np.complex128]:
    """(H, W, 1) 60 MHz phasors with the integrator and film of mitransient and an independent sampler."""
    import mitransient  # noqa: F401  (registers transient_path)
    import mitsuba as mi

    sensor = scene.sensors()[0]
    film = {
        "type": "transient_hdr_film",
        "width": layout.width,
        "height": layout.height,
        "temporal_bins": layout.bin_count,
        "bin_width_opl": layout.bin_width_m,
        "start_opl": layout.start_opl_m,
        "rfilter": {"type": "box"},
    }
    camera = {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(mi.traverse(sensor)["x_fov"][0]),
        "to_world": mi.ScalarTransform4f(np.array(sensor.world_transform().matrix).reshape(4, 4)),
        "film": film,
    }
    integrator = mi.load_dict({"type": "transient_path", "max_depth": 4})
    _, transient = integrator.render(scene, mi.load_dict(camera), seed=seed, spp=spp)
    return phasors(np.array(transient)[..., 0], HZ, layout.bin_width_m)


if __name__ == "__main__":
    main()
