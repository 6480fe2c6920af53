"""NIGHT's renderers beside those of mitransient: error, CPU seconds, and how many times less efficient.

A flash lights a diffuse wall; wanted are the hidden phasors of every pixel at 60 MHz. All errors are total
errors, relative to the hidden signal, against the quadrature of `tests/support/batch_quadrature.py`. The
renderers take turns in one process; the first turn, which compiles kernels, does not count. The ratio is
error² x CPU seconds over that of the first line; of noise alone, it is the same for any number of paths.

mitransient has its best settings, its film without bins, `phasor_hdr_film`, and a near clip plane at 0.1 mm:

- lasers: `transient_nlos_path` renders one laser after the other, at Gauss nodes of the projector's film.
- NLOS flash: the same integrator, with next-event estimation to the projector.
- transient_path: the direct return of `many-light` is subtracted.

Hidden geometry sampling is kept to the hidden object. Version 1.3.1 changes two arguments in place, which
changes them for the caller, too; they are copied here. It sees only the front of the concave plane. Run:

    .venv/bin/python benchmarks/peers.py
"""

import argparse
import itertools
import resource
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from seven_scenes import made_datasets

from itof import SPEED_OF_LIGHT, TransientLayout, phasors
from render.backend import select_variant
from render.batch.light import BatchedLight
from render.options import ManyLightOptions, PathOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.path_tracer import PathTracer
from render.transport.scene_loading import scene_from_data
from scenegen import Dataset
from scenegen.mitsuba_description import seen_description
from scenegen.scene_folder import read_scene_folder
from scenegen.triangles import scene_triangles

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from batch_quadrature import CubeLight

HZ = (60e6,)
HIDDEN = "hidden_object_0.ply"
LARGE = 160  # pixels in a row
COPIES = 16  # of a scene in a batch
# Longest edge of a triangle in metres, and a third of the cells of a column.
REFERENCES = ((0.04, 8), (0.025, 12))
Image = NDArray[np.complex128]  # (H, W, 1)
Renderers = dict[str, tuple[Callable[[int], Image], int, int]]  # render(seed), paths per pixel or 0, scenes


def main() -> None:
    """Print a table for each scene."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["sphere", "cube", "concave_plane"])
    parser.add_argument("--size", default="32x24")
    parser.add_argument("--errors", type=float, nargs="+", default=[0.01, 0.002], help="of many-light")
    parser.add_argument("--lasers", nargs="+", default=["8x6:132", "8x6:528"], help="nodes: paths a pixel")
    parser.add_argument("--spot", action="store_true", help="0.2 degrees wide, instead of the flash")
    parser.add_argument("--turns", type=int, default=4, help="that count, default 4; at least 2")
    given = parser.parse_args()
    if given.turns < 2:
        parser.error("bias and noise need 2 turns at least")
    variant = select_variant("cpu")
    width, height = map(int, given.size.split("x"))
    data: dict[str, Any] = {"dataset": {"count": 7}, "relay_wall": {"material": "diffuse"}}
    data["camera"] = {"width": width, "height": height}
    if given.spot:
        data["projector"] = {"horizontal_fov_deg": 0.2, "dots": [1, 1], "rotation_deg": [90.0, 0.0, 56.0]}
    with TemporaryDirectory() as folder:
        (dataset,) = made_datasets({Path(folder) / "data": data})
        for scene_id in dataset.ids():
            if dataset.scene(scene_id).object_class in given.scenes:
                compare(Work(dataset, scene_id), variant, given)


def compare(work: "Work", variant: str, given: argparse.Namespace) -> None:
    """The table of a scene."""
    coarse, truth = (work.quadrature(*size) for size in REFERENCES)
    change, power = np.linalg.norm(truth - coarse), np.linalg.norm(truth)
    print(f"\n{work.scene.object_class}, {given.size}; reference within {change / power:.2%}\n")
    print("| renderer | total error | of it bias | CPU s | noise x sqrt(paths) | ratio |")
    print("|---|---|---|---|---|---|")
    renderers = ours(work, variant, given.errors) | peers(work, given.lasers)
    missed: dict[str, list[Image]] = {name: [] for name in renderers}
    seconds = dict.fromkeys(renderers, 0.0)
    for turn, (name, (render, _, scenes)) in itertools.product(range(given.turns + 1), renderers.items()):
        began = cpu_seconds()
        image = render(1 + 7919 * turn)
        if turn:
            missed[name].append((image - truth) / power)
            seconds[name] += (cpu_seconds() - began) / given.turns / scenes
    first = None
    for name, (_, spp, _) in renderers.items():
        square = np.mean([np.linalg.norm(each) ** 2 for each in missed[name]])
        shared = np.mean([np.vdot(a, b).real for a, b in itertools.combinations(missed[name], 2)])
        noise, bias = (np.sqrt(max(each, 0)) for each in (square - shared, shared))
        first = first or square * seconds[name]
        figures = f"{np.sqrt(square):.2%} | {bias:.2%} | {seconds[name]:.3f} | {noise * np.sqrt(spp):.1f}"
        print(f"| {name} | {figures} | {square * seconds[name] / first:,.3g} |", flush=True)


def cpu_seconds() -> float:
    """Of all threads of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


class Work:
    """A scene, its reference, and what both sides need of it."""

    def __init__(self, dataset: Dataset, scene_id: str) -> None:
        self.scene, self.folder = dataset.scene(scene_id), dataset.scene_folder(scene_id)
        self.description = seen_description(self.scene)
        self.is_open = self.scene.object_class == "concave_plane"  # seen from both sides, and hides itself
        self.loaded = self.load({})
        self.film = CubeLight(self.scene, HZ, 1, 1)  # its camera and wall
        self.direct: Any = 0.0  # of many-light, which renders first

    def load(self, changed: dict[str, Any]) -> Any:
        """The scene with other parts, and the normals of an open object towards the wall."""
        files = dict(read_scene_folder(self.folder))
        if self.is_open:
            mesh = trimesh.Trimesh(*scene_triangles(files[HIDDEN], HIDDEN), process=False)
            mesh.invert()
            files[HIDDEN] = mesh.export(file_type="ply", vertex_normal=False)
        return scene_from_data({**self.description, **changed}, files, self.folder)

    def quadrature(self, longest_m: float, cells: int) -> Image:
        """The hidden light, as means of 2 x 2 points of each pixel; in large images, at its middle."""
        file = self.folder / HIDDEN
        triangles = scene_triangles(file.read_bytes(), str(file))
        vertices, faces = trimesh.remesh.subdivide_to_size(*triangles, longest_m)
        corners = vertices[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(normals, axis=1)
        surface, shadow = [corners.mean(1), normals / areas[:, None], areas / 2], None
        if self.is_open:
            surface = [np.concatenate([each, each]) for each in surface]
            surface[1][len(areas) :] *= -1
            shadow = partial(self._hides_itself, surface[0] + 2e-5 * surface[1])
        light = CubeLight(self.scene, HZ, cells, surface=surface, shadow=shadow)
        width, height = self.scene.camera.width, self.scene.camera.height
        points = 2 if width < LARGE else 1
        image = light.hidden(*light.centres(points * width, points * height))
        return image.reshape(height, points, width, points, len(HZ)).mean(axis=(1, 3))

    def paths(self, count: int) -> int:
        """Paths a pixel, so that an image has `count` for each pixel of 32 x 24, at least 8."""
        return max(8, count * 32 * 24 // (self.scene.camera.width * self.scene.camera.height))

    def _hides_itself(self, points: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.bool_]:
        import mitsuba as mi

        ways = at[:, None] - points
        starts, ways = (each.reshape(-1, 3).T.astype("f4") for each in (points + 0 * ways, ways))
        ray = mi.Ray3f(mi.Point3f(starts), mi.Vector3f(ways))
        ray.maxt = mi.Float(0.999)
        return np.array(self.loaded.ray_test(ray)).reshape(len(at), -1)


def ours(work: Work, variant: str, errors: list[float]) -> Renderers:
    """The methods of NIGHT."""
    size = (work.scene.camera.width, work.scene.camera.height)
    layout = TransientLayout(*size, 1500, 0.01, 0.0)
    batched = BatchedLight(HZ, *size, error=errors[0], device="cpu")

    def many_light(error: float, seed: int) -> Image:
        method = ManyLight(ManyLightOptions(error=error), variant)
        image = method.expose(work.loaded, View(layout, HZ, 3, seed)).phasors()
        work.direct = image.direct
        return image.hidden

    spp = work.paths(1024)

    def path(seed: int) -> Image:
        exposure = PathTracer(PathOptions(spp=spp), variant).expose(work.loaded, View(layout, HZ, 3, seed))
        return phasors(np.concatenate(list(exposure.row_blocks())), HZ, layout.bin_width_m) - work.direct

    found: Renderers = {f"many-light {error:g}": (partial(many_light, error), 0, 1) for error in errors}
    if not work.scene.has_flash:
        return found
    found["batched"] = (lambda _: batched.images([work.scene] * COPIES).hidden[0], 0, COPIES)
    return found | {"path": (path, spp, 1)}


def peers(work: Work, lasers: list[str]) -> Renderers:
    """The integrators of mitransient."""
    import mitransient  # noqa: F401  (registers its plugins)
    import mitsuba as mi

    mi.set_log_level(mi.LogLevel.Error)
    period_m, film = SPEED_OF_LIGHT / HZ[0], dict(work.description["sensor"]["film"])
    film |= {"type": "phasor_hdr_film", "temporal_bins": 64, "bin_width_opl": period_m / 64, "start_opl": 0.0}
    film |= {"wl_mean": period_m, "wl_sigma": 1e30}  # this frequency alone
    del film["pixel_format"]
    pose = mi.ScalarTransform4f(np.array(work.description["sensor"]["to_world"]))
    beam = {"type": "projector", "fov": 0.2, "irradiance": 1.0, "to_world": pose}
    clip = {"near_clip": 1e-4, "sampler": {"type": "multijitter"}}
    sensor = mi.load_dict({**work.description["sensor"], **clip, "film": film, "to_world": pose})
    nlos = {
        "type": nlos_path(),
        "nlos_hidden_geometry_sampling": True,
        "account_first_and_last_bounces": True,
    }
    nlos |= {"temporal_filter": "box", "rr_depth": 100}
    flash = {**nlos, "nlos_hidden_geometry_sampling_max_depth": 1, "filter_depth": 2, "max_depth": 4}
    laser = {**nlos, "nlos_laser_sampling": True, "discard_direct_paths": True, "max_depth": 3}
    plain = {"type": "transient_path", "max_depth": 4, "rr_depth": 100}
    flash, laser, plain = map(mi.load_dict, (flash, laser, plain))
    with_flash, with_laser = work.load({}), work.load({"emitter": beam})

    def rendered(integrator: Any, scene: Any, spp: int, seed: int) -> Image:
        import drjit as dr

        image = integrator.render(scene, sensor, seed=dr.opaque(mi.UInt32, seed), spp=spp)[1]
        return np.array(image) @ [1, -1j]  # the film has the conjugate

    def summed(columns: int, rows: int, spp: int, seed: int) -> Image:
        (x, across), (y, down) = map(np.polynomial.legendre.leggauss, (columns, rows))
        projector = work.film.projector
        wide, high = projector.half
        places, _, cosines = work.film.on_wall(*np.meshgrid(x * wide, y * high), projector)
        # A laser is taken for π / distance² on a square metre; the projector has π times an area of its film.
        squared = ((places - projector.place) ** 2).sum(-1)
        weights = np.outer(down, across) * wide * high * squared / cosines
        total = 0.0
        for number, (place, weight) in enumerate(zip(places.reshape(-1, 3), weights.ravel(), strict=True)):
            parameters = mi.traverse(with_laser.emitters()[0])
            eye, target = (mi.Point3f(*each.tolist()) for each in (projector.place, place))
            parameters["to_world"] = mi.Transform4f().look_at(eye, target, mi.Vector3f(0, 0, 1))
            parameters.update()
            total = total + weight * rendered(laser, with_laser, spp, seed + 104729 * number)
        return total

    found: Renderers = {}
    if work.scene.has_flash:
        few, many = map(work.paths, (1024, 4096))
        found["NLOS flash"] = (partial(rendered, flash, with_flash, few), few, 1)
        found["transient_path"] = (
            lambda seed: rendered(plain, work.loaded, many, seed) - work.direct,
            many,
            1,
        )
    for text in lasers:
        columns, rows, spp = map(int, text.replace(":", "x").split("x"))
        found[f"lasers {text}"] = (partial(summed, columns, rows, spp), 0, 1)
    return found


def nlos_path() -> str:
    """Registers `transient_nlos_path` with the two changes; its name."""
    import mitsuba as mi
    from mitransient.integrators.transientnlospath import TransientNLOSPath

    def copied(values: Any) -> Any:
        return [type(value)(value) if type(value) in (mi.Float, mi.Bool) else value for value in values]

    class Changed(TransientNLOSPath):
        def prepare(self, scene, *given, **named):
            made = super().prepare(scene, *given, **named)
            shapes = [scene.shapes()[int(index)] for index in np.array(self.hidden_geometry_shape_indices)]
            areas = [shape.surface_area()[0] * shape.id().startswith("hidden_object") for shape in shapes]
            self.hidden_geometries_distribution = mi.DiscreteDistribution(areas)
            return made

        def emitter_nee_sample(self, *given, **named):
            named = dict(zip(named, copied(named.values()), strict=True))
            return super().emitter_nee_sample(*copied(given), **named)

        def emitter_laser_targets_sample(self, *given, **named):
            named = dict(zip(named, copied(named.values()), strict=True))
            return super().emitter_laser_targets_sample(*copied(given), **named)

    mi.register_integrator("changed_nlos_path", lambda properties: Changed(properties))
    return "changed_nlos_path"


if __name__ == "__main__":
    main()
