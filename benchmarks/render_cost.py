"""Time and memory of ``many-light`` for a scene pair at 320 x 240, and how the time grows.

A scene pair is a scene and its mirrored scene, with all files written. The first scene compiles the
kernels and is not counted. Run each product in a separate process, because memory is the peak of the
process:

    .venv/bin/python benchmarks/render_cost.py itof
    .venv/bin/python benchmarks/render_cost.py transient
    .venv/bin/python benchmarks/render_cost.py growth
"""

import argparse
import resource
import time

import numpy as np
import trimesh
from four_scenes import four_scenes

from itof import TransientLayout, read_image
from render.backend import select_variant
from render.options import ManyLightOptions
from render.rendering import Renderer
from render.settings import RenderSettings
from render.transport.gather_pass import Grid, gather_lights, gauss_rule
from render.transport.many_light import ManyLight
from render.transport.method import View

HZ = (20e6, 50e6, 60e6)


def pairs(product: str, error: float) -> None:
    """Seconds and peak memory per scene pair."""
    print(f"QVGA, product {product}, hidden error {error:.2%}, scene and mirrored scene, files written")
    print("scene                seconds   lights  error   peak MB       MB on disk")
    with four_scenes() as scenes:
        for warm in (True, False):
            for name, dataset, scene_id in scenes[: 1 if warm else None]:
                settings = RenderSettings(product=product, options=ManyLightOptions(error=error))
                renderer = Renderer(dataset, settings)
                started = time.perf_counter()
                renderer.render(scene_id)
                seconds = time.perf_counter() - started
                folder = dataset.render_folder(scene_id)
                header = read_image(folder / "itof.exr").attributes
                size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
                if not warm:
                    print(
                        f"{name:<18} {seconds:9.2f} {header['lights']:>8} {header['hidden_error']:>6} "
                        f"{peak:9.0f} {size:16.1f}"
                    )


def growth() -> None:
    """Time of the gather pass for numbers of pixels, lights and triangles, and of transients for bins."""
    variant = select_variant()
    import drjit as dr
    import mitsuba as mi

    with four_scenes() as scenes:
        name, dataset, scene_id = scenes[0]
        file = dataset.scene_folder(scene_id) / "scene.xml"
        scene = mi.load_file(str(file), optimize=False)
        print(f"gather pass, {name}, {variant}: seconds, million pixel-light pairs per second")
        for width, lights in ((80, 1024), (160, 1024), (320, 256), (320, 1024), (320, 4096)):
            seconds, rate = gather(scene, variant, width, lights)
            print(f"  {width:4d} wide, {lights:5d} lights: {seconds:7.2f} s {rate:7.1f} M/s")
        print(f"  bare ray_test on the same scene: {ray_tests(scene):7.1f} M rays/s")
        mesh_file = dataset.scene_folder(scene_id) / "hidden_object_0.ply"
        mesh = trimesh.load(mesh_file)
        for _ in range(3):
            mesh = mesh.subdivide()
            mesh_file.write_bytes(mesh.export(file_type="ply"))
            finer = mi.load_file(str(file), optimize=False)
            seconds, rate = gather(finer, variant, 320, 1024)
            print(f"  {len(mesh.faces):7d} triangles: {seconds:7.2f} s {rate:7.1f} M/s")
        for bins in (500, 2000, 8000):
            seconds = transient(scene, variant, bins)
            print(f"  transient, 80 x 60, {bins:5d} bins: {seconds:7.2f} s")
        dr.sync_thread()


def gather(scene, variant: str, width: int, lights: int) -> tuple[float, float]:
    """Seconds of the gather pass, and million pixel-light pairs per second."""
    layout = TransientLayout(width, width * 3 // 4, 2000, 0.01, 0.0)
    method = ManyLight(ManyLightOptions(lights=lights), variant)
    made = method.expose(scene, View(layout, HZ, 3, 1)).lights
    grid = Grid(layout.width, layout.height)
    gather_lights(scene, grid, HZ, gauss_rule(1), made)  # compiles the kernels
    started = time.perf_counter()
    gather_lights(scene, grid, HZ, gauss_rule(1), made)
    seconds = time.perf_counter() - started
    return seconds, layout.width * layout.height * len(made) / seconds / 1e6


def transient(scene, variant: str, bins: int) -> float:
    """Seconds of a transient with 80 x 60 pixels and 1024 lights."""
    layout = TransientLayout(80, 60, bins, 20 / bins, 0.0)
    exposure = ManyLight(ManyLightOptions(lights=1024), variant).expose(scene, View(layout, HZ, 3, 1))
    started = time.perf_counter()
    for _ in exposure.row_blocks():
        pass
    return time.perf_counter() - started


def ray_tests(scene) -> float:
    """Million occlusion rays per second, from the relay wall to the place of the hidden object."""
    import drjit as dr
    import mitsuba as mi

    count = 2**22
    rng = np.random.default_rng(0)
    wall = mi.Point3f(
        np.stack([np.full(count, 1e-3), *rng.uniform([[-0.8], [0.8]], [[1.7], [2.5]], (2, count))])
    )
    place = mi.Point3f(rng.uniform([[1.0], [0.5], [1.25]], [[1.3], [1.3], [1.95]], (3, count)))
    dr.eval(wall, place)
    best = 0.0
    for _ in range(4):
        started = time.perf_counter()
        hit = scene.ray_test(mi.Ray3f(wall, dr.normalize(place - wall), dr.norm(place - wall), 0, []))
        dr.eval(hit)
        dr.sync_thread()
        best = max(best, count / (time.perf_counter() - started) / 1e6)
    return best


def main() -> None:
    """Run the chosen benchmark."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("what", choices=["itof", "transient", "growth"])
    arguments.add_argument("--error", type=float, default=0.005)
    given = arguments.parse_args()
    if given.what == "growth":
        growth()
    else:
        pairs("itof" if given.what == "itof" else "both", given.error)


if __name__ == "__main__":
    main()
