"""Time at equal error of ``many-light`` and of mitransient's own ``transient_path``, in one run.

For each of four scenes, measures the time of both methods and the noise of their hidden 60 MHz phasors,
relative to the hidden signal. Half the squared difference of two seeds is the variance. Error² x time is
proportional to the time for a given error, so the ratio of these products says how many times faster
``many-light`` is. The bias of the stock method (box bins, paths that start at the near clip plane) is not
counted, which favours the stock method. Run:

    .venv/bin/python benchmarks/render_efficiency.py
"""

import argparse
import time

import numpy as np
from four_scenes import four_scenes

from itof import TransientLayout, phasors
from render.backend import select_variant
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import View

HZ = (60e6,)


def main() -> None:
    """Print a line per scene."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--width", type=int, default=80)
    arguments.add_argument("--spp", type=int, default=1024)
    arguments.add_argument("--lights", type=int, default=1024)
    given = arguments.parse_args()
    layout = TransientLayout(given.width, given.width * 3 // 4, 1500, 0.01, 0.0)
    variant = select_variant()
    import mitransient  # noqa: F401  (registers transient_path)
    import mitsuba as mi

    print(f"{layout.width} x {layout.height} pixels, {variant}")
    print("scene                 method          error    seconds   error² s     ratio")
    with four_scenes() as scenes:
        for name, dataset, scene_id in scenes:
            scene = mi.load_file(str(dataset.scene_folder(scene_id) / "scene.xml"), optimize=False)
            view = View(layout, HZ, 3, 1)
            fine = ManyLight(ManyLightOptions(lights=8192), variant).expose(scene, view).phasors().hidden
            norm = np.linalg.norm(fine)

            def many_light(seed, scene=scene):
                view = View(layout, HZ, 3, seed)
                return (
                    ManyLight(ManyLightOptions(lights=given.lights), variant)
                    .expose(scene, view)
                    .phasors()
                    .total
                )

            def stock(seed, scene=scene):
                return stock_transient_path(scene, layout, given.spp, seed)

            needs = {}
            for method, label in ((stock, f"stock, {given.spp} spp"), (many_light, f"{given.lights} lights")):
                method(0)  # compiles the kernels
                started = time.perf_counter()
                a, b = method(1), method(2)
                seconds = (time.perf_counter() - started) / 2
                error = np.linalg.norm(a - b) / np.sqrt(2) / norm
                needs[method] = error**2 * seconds
                ratio = f"{needs[stock] / needs[method]:10.0f}"
                print(f"{name:<20}  {label:<14} {error:8.4f} {seconds:10.2f} {needs[method]:10.2e}{ratio}")


def stock_transient_path(scene, layout: TransientLayout, spp: int, seed: int) -> np.ndarray:
    """(H, W, 1) 60 MHz phasors with the integrator and film of mitransient and an independent sampler."""
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
