"""Time and memory of ``many-light`` for a scene pair, and how they grow.

A scene pair is a scene and its mirrored scene, with all files written. Each scene is rendered once before it
is measured, because the first time compiles its kernels. The median of --repeats renders is printed. With
`transient`, each scene is also rendered to phasors alone, for the ratio of both in one run. A pair is a light
and a node of the lattice of curves over time; the limit is the shadow rays of the same pairs. Run:

    .venv/bin/python benchmarks/render_cost.py itof
    .venv/bin/python benchmarks/render_cost.py transient
    .venv/bin/python benchmarks/render_cost.py growth
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import trimesh
from seven_scenes import SCENES, seven_scenes

from render.backend import select_variant
from render.options import ManyLightOptions
from render.rendering import Renderer
from render.settings import RenderSettings
from render.transport import many_light
from render.transport.many_light import make_field
from render.transport.passes import hidden_curves
from scenegen import Dataset

SIZES = tuple((4 * n, 3 * n) for n in (10, 20, 40, 80, 160, 320))
ERRORS = (0.02, 0.01, 0.005, 0.002, 0.001)
LIGHTS = (256, 1024, 4096, 16384)
TRIANGLES = (1, 3, 5, 7, 8)  # subdivisions of an icosahedron: 80, 1280, 20 and 328 thousand, 1.3 million
BINS = (500, 2000, 6000)  # at 320 x 240; more are not written


def main() -> None:
    """Run the chosen benchmark."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("what", choices=["itof", "transient", "growth"])
    arguments.add_argument("--size", default="320x240", help="image size, default 320x240")
    arguments.add_argument("--error", type=float, default=0.005, help="wanted error, default 0.005")
    arguments.add_argument("--repeats", type=int, default=3, help="renders of which the median counts")
    arguments.add_argument(
        "--scene", nargs="+", choices=[name for name, _ in SCENES], help="all; sphere for growth"
    )
    arguments.add_argument("--most", type=float, default=0, help="growth: skip what is larger than this")
    given = arguments.parse_args()
    print(f"{given.size} pixels, error {given.error:g}, {select_variant()}")
    names = given.scene or (["sphere"] if given.what == "growth" else [])
    with seven_scenes(tuple(names)) as scenes:
        if given.what == "growth":
            growth(*scenes[0], given)
        else:
            pairs(scenes, given)


def settings_of(given: argparse.Namespace, **changes: Any) -> RenderSettings:
    """Settings of the render that the command line asks for."""
    size = tuple(map(int, given.size.split("x")))
    settings = RenderSettings(options=ManyLightOptions(error=given.error), resolution=size)
    return replace(settings, **changes)


def measured(dataset: Dataset, scene_id: str, settings: RenderSettings, repeats: int) -> dict[str, str]:
    """Time of a scene pair, lights, lattice, reported error, peak memory, and size of the files."""
    import drjit as dr

    renderer = Renderer(dataset, settings)
    renderer.render(scene_id)
    times, used = [], time.process_time()
    dr.flush_malloc_cache()
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts again from here
    fields = []

    def kept(*given: Any, **named: Any) -> Any:
        fields.append(make_field(*given, **named))
        return fields[-1]

    with patch.object(many_light, "make_field", kept):
        for _ in range(repeats):
            started = time.perf_counter()
            record = renderer.render(scene_id)
            times.append(time.perf_counter() - started)
    used = (time.process_time() - used) / repeats
    lattice = fields[-1].lattice
    status = Path("/proc/self/status").read_text()
    peak_kb = int(status.split("VmHWM:")[1].split()[0])
    return {
        "seconds": f"{median(times):.2f}",
        "CPU seconds": f"{used:.2f}",
        "lights": record.attributes["lights"],
        "lattice": f"{lattice.columns} x {lattice.rows}" if lattice else "none",
        "reported error": f"{float(record.attributes['hidden_error']):.2%}",
        "peak memory, MB": f"{peak_kb / 1e3:.0f}",
        "on disk, MB": f"{sum(file.bytes for file in record.files.values()) / 1e6:.2f}",
    }


def pairs(scenes: list[tuple[str, Dataset, str]], given: argparse.Namespace) -> None:
    """Print a line per scene."""

    def row(dataset: Dataset, scene_id: str) -> dict[str, str]:
        found = measured(dataset, scene_id, settings_of(given), given.repeats)
        if given.what == "itof":
            return found
        seconds, curves = found["CPU seconds"], CurvePairs()
        with patch.object(hidden_curves, "_curves_at", curves.counted):
            found = measured(dataset, scene_id, settings_of(given, product="both"), given.repeats)
        ratio = float(found["CPU seconds"]) / float(seconds)
        found |= {"CPU seconds of phasors": seconds, "ratio": f"{ratio:.1f}"}
        return found | {
            "million pairs": f"{curves.pairs / given.repeats / 1e6:.2f}",
            "million a CPU second": f"{curves.pairs / curves.seconds / 1e6:.1f}",
            "limit": f"{curves.limit / 1e6:.1f}",
        }

    print_table("scene", ((name, row(*scene)) for name, *scene in scenes))


class CurvePairs:
    """Counts the pairs of curves over time, their CPU seconds, and shadow rays a CPU second."""

    def __init__(self) -> None:
        self.pairs, self.seconds, self.limit, self.curves_at = 0, 0.0, 0.0, hidden_curves._curves_at

    def counted(self, scene: Any, nodes: Any, field: Any, *given: Any) -> Any:
        """The curves at `nodes`."""
        began = time.process_time()
        curves = self.curves_at(scene, nodes, field, *given)
        if self.limit:
            self.pairs += len(nodes) * len(field.lights)
            self.seconds += time.process_time() - began
        else:  # the first call compiles
            self.limit = max(self.shadow_rays(scene, nodes, field.lights) for _ in range(3))
        return curves

    def shadow_rays(self, scene: Any, nodes: Any, lights: Any) -> float:
        """Shadow rays between the nodes on the wall and the lights, a CPU second."""
        import drjit as dr
        import mitsuba as mi

        from render.transport.kernels import arrays, rays

        x, y = (arrays.upload(column) for column in nodes.T)
        wall, light = rays.camera_hits(scene, x, y).p, arrays.upload_points(lights.position)
        pair = dr.arange(mi.UInt32, len(nodes) * len(lights))
        count = dr.opaque(mi.UInt32, len(lights))
        start = dr.gather(mi.Point3f, light, pair % count)
        way = dr.gather(mi.Point3f, wall, pair // count) - start
        dr.eval(start, way)
        dr.sync_thread()
        began = time.process_time()
        dr.eval(scene.ray_test(mi.Ray3f(start, way, 0.999, 0.0, [])))
        dr.sync_thread()
        return len(nodes) * len(lights) / (time.process_time() - began)


def growth(name: str, dataset: Dataset, scene_id: str, given: argparse.Namespace) -> None:
    """Print tables of the cost against pixels, error, lights, bins and triangles."""

    def cost(at: Dataset = dataset, **changes: Any) -> dict[str, str]:
        return measured(at, scene_id, settings_of(given, **changes), given.repeats)

    def small(values: tuple[Any, ...], size: Any = float) -> list[Any]:
        return [value for value in values if not given.most or size(value) <= given.most]

    def pixels(size: tuple[int, int]) -> int:
        return size[0] * size[1]

    print(f"{name}; what a table does not vary is as above")
    sizes = small(SIZES, pixels)
    print_table("pixels", ((f"{s[0]} x {s[1]}", cost(resolution=s)) for s in sizes))
    errors = small(ERRORS, lambda error: 1 / error)
    print_table("error", ((f"{e:.1%}", cost(options=ManyLightOptions(error=e))) for e in errors))
    print_table("`--lights`", ((n, cost(options=ManyLightOptions(lights=n))) for n in small(LIGHTS)))
    bins = ((n, with_bins(dataset, n)) for n in small(BINS))
    print_table("bins, with transients", ((n, cost(other, product="both")) for n, other in bins))
    made = made_triangles(dataset, scene_id, small(TRIANGLES, lambda times: 20 * 4**times))
    print_table("triangles", ((f"{count:,}", cost(accept_edited=True)) for count in made))


def with_bins(dataset: Dataset, count: int) -> Dataset:
    """The dataset with `count` bins on the same time axis."""
    preset = dataset.preset
    axis = preset.transient
    axis = replace(axis, bin_count=count, bin_width_m=axis.bin_width_m * axis.bin_count / count)
    return replace(dataset, index=replace(dataset.index, preset=replace(preset, transient=axis)))


def made_triangles(dataset: Dataset, scene_id: str, times: list[int]) -> Iterator[int]:
    """Put a subdivided icosahedron, as large as the sphere, in its place; the number of its triangles."""
    file = dataset.scene_folder(scene_id) / "hidden_object_0.ply"
    box = trimesh.load(file).bounds
    for subdivisions in times:
        mesh = trimesh.creation.icosphere(subdivisions, radius=(box[1] - box[0]).mean() / 2)
        mesh.apply_translation(box.mean(axis=0))
        file.write_bytes(mesh.export(file_type="ply", vertex_normal=False))
        yield len(mesh.faces)


def print_table(first: str, rows: Iterator[tuple[Any, dict[str, str]]]) -> None:
    """Print a table in Markdown, line by line as the rows are measured."""
    for number, (name, values) in enumerate(rows):
        if number == 0:
            print(f"\n| {first} | {' | '.join(values)} |\n|---|{'---|' * len(values)}")
        print(f"| {name} | {' | '.join(values.values())} |", flush=True)


if __name__ == "__main__":
    main()
