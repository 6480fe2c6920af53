"""Time and memory of ``many-light`` for a scene pair, and how they grow.

A scene pair is a scene and its mirrored scene, with all files written. Each scene is rendered once before it
is measured, because the first time compiles its kernels. The median of --repeats renders is printed. With
`transient`, each scene is also rendered to phasors alone, for the ratio of both in one run. Run:

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
        seconds = found["CPU seconds"]
        found = measured(dataset, scene_id, settings_of(given, product="both"), given.repeats)
        ratio = float(found["CPU seconds"]) / float(seconds)
        return found | {"CPU seconds of phasors": seconds, "ratio": f"{ratio:.1f}"}

    print_table("scene", ((name, row(*scene)) for name, *scene in scenes))


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
