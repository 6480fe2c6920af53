"""How much of a surface of any shape the hidden light determines: a posterior of its depth map.

The surface has one radius in each direction about its middle, in spherical harmonics. Known of it is a normal
prior, about as wide as the errors of a network: the middle is 1.5 cm off along each axis, and the radii by
8 % over l + 1 for the degree l. The light is that of three bounces from a diffuse wall, as a plain sum over
triangles; one line compares it with the engine. Its error is the given share of the hidden light, spread
evenly over 14 independent values (`model.refinement.evidence`). The posterior follows from the derivatives.
Printed are mean absolute differences of depth maps to that of the surface, of draws of the prior and of the
posterior, and how many numbers of the surface the light determines better than the prior.

Run:

    .venv/bin/python benchmarks/surface_bound.py
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from out_of_range import meshes
from scipy.special import sph_harm_y

from itof import phase_per_metre, pixel_rays
from itof.wall.wall_view import WallView
from model.refinement.evidence import INDEPENDENT
from model.refinement.hidden_light import HiddenLight
from model.refinement.light.corner_light import Mirror
from render.batch.candidates import CandidateLight
from scenegen.pose import camera_axes, rotation_matrix, wall_geometry
from scenegen.preset import load_preset
from scenegen.sampling import sample_scene
from scenegen.scene import Scene

Floats = NDArray[np.float64]
HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 40, 30
FILM = (12, 9)  # points that the projector lights
MIDDLE_M, RADII, DEGREE = 0.015, 0.08, 6  # of the prior; the deviation of the degree l is RADII / (l + 1)
ERRORS = (0.02, 0.01, 0.002)
STEP = 0.1  # of the differences, in deviations of the prior
DRAWS = 24
LEAST_M = 0.02  # of a radius, where a shape does not surround its middle
DIRECTIONS = trimesh.creation.icosphere(3)


def main() -> None:
    """Print a line for each shape."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--scenes", type=int, default=6, help="poses of each shape, default 6")
    given = arguments.parse_args()
    preset = load_preset("paper")
    corners = [sample_scene(preset, index) for index in range(given.scenes)]
    print(f"the sum differs from the engine by {100 * against_engine(corners[0]):.1f} %")
    heads = [f"{100 * error:g} %: cm | numbers" for error in ERRORS]
    print(f"| shape | prior: cm | {' | '.join(heads)} |\n|{'---|' * (2 + 2 * len(ERRORS))}")
    shapes = {
        "sphere": trimesh.creation.icosphere(3, 0.25),
        "cube": trimesh.creation.box((0.4, 0.4, 0.4)),
        **meshes(),
    }
    for name, mesh in shapes.items():
        if name != "balls":  # they have two middles
            found = np.mean([bounds(radii_m(mesh), corner) for corner in corners], axis=0)
            cells = [
                f"{100 * found[0]:.1f}",
                *(f"{100 * a:.1f} | {b:.0f}" for a, b in found[1:].reshape(-1, 2)),
            ]
            print(f"| {name} | {' | '.join(cells)} |", flush=True)


def radii_m(mesh: trimesh.Trimesh) -> Floats:
    """(V,) how far a shape of 0.5 m reaches along each of the directions."""
    mesh = mesh.copy().apply_translation(-mesh.bounds.mean(axis=0)).apply_scale(0.5 / mesh.extents.max())
    far: Floats = reach(np.zeros(3), np.array(DIRECTIONS.vertices), np.array(mesh.triangles))
    return np.maximum(np.where(np.isfinite(far), far, 0).max(axis=1), LEAST_M)


@dataclass(frozen=True)
class Surface:
    """(V,) radii of a surface about the middle of a scene's object, turned as that."""

    scene: Scene
    radius_m: Floats

    def moved(self, changes: Floats) -> Floats:
        """(N, V, 3) vertices in world axes after changes (N, 3 + K) of the middle and of the logarithms."""
        part = self.scene.hidden_objects[0]
        radius_m = self.radius_m * np.exp(changes[:, 3:] @ harmonics().T)
        offset = radius_m[..., None] * (DIRECTIONS.vertices @ rotation_matrix(part.rotation_deg).T)
        vertices: Floats = np.asarray(part.location_m) + changes[:, None, :3] + offset
        return vertices


def harmonics() -> Floats:
    """(V, K) real spherical harmonics in all directions, with a root mean square of 1."""
    x, y, z = DIRECTIONS.vertices.T
    polar, azimuth = np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x)
    columns = []
    for degree in range(DEGREE + 1):
        for order in range(-degree, degree + 1):
            wave = np.sqrt(4 * np.pi) * sph_harm_y(degree, abs(order), polar, azimuth)
            columns.append(np.sqrt(2) * (wave.real if order > 0 else wave.imag) if order else wave.real)
    return np.stack(columns, axis=1)


def deviations() -> Floats:
    """(3 + K,) standard deviations of the prior."""
    degrees = np.repeat(np.arange(DEGREE + 1), 2 * np.arange(DEGREE + 1) + 1)
    return np.concatenate([np.full(3, MIDDLE_M), RADII / (degrees + 1)])


def bounds(radius_m: Floats, scene: Scene) -> Floats:
    """MAE of the prior, then MAE of the posterior and numbers determined for each error, metres."""
    surface, prior = Surface(scene, radius_m), deviations()
    steps = STEP * np.diag(prior)
    wall = WallView(**wall_geometry(scene.camera, scene.relay_wall))
    expected = wall.expected_wall(wall.direct_phasors(WIDTH, HEIGHT, HZ), HZ)
    still = surface.moved(np.zeros((1, len(prior))))
    hidden = over_direct(scene, still, expected.rays.reshape(-1, 3))[0].reshape(HEIGHT, WIDTH, -1)
    observed = HiddenLight.of(expected.direct * (1 + hidden), expected, fine=True)
    if observed is None:
        raise SystemExit("this corner shows too little of its relay wall")
    values = [
        np.stack(
            [observed.of_model(light) for light in over_direct(scene, surface.moved(each), observed.rays)]
        )
        for each in (steps, -steps)
    ]
    jacobian = ((values[0] - values[1]) / (2 * STEP)).T  # by deviations of the prior
    true_m = depths_m(scene, still)
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((DRAWS, len(prior)))

    def differing_m(changes: Floats) -> float:
        return float(np.abs(depths_m(scene, surface.moved(changes * prior)) - true_m).mean())

    found = [differing_m(normal)]
    for error in ERRORS:
        noise = error * np.linalg.norm(observed.values) / np.sqrt(INDEPENDENT)
        _, sizes, axes = np.linalg.svd(jacobian / noise)
        known = np.pad(sizes, (0, len(prior) - len(sizes)))
        found += [differing_m(normal / np.sqrt(1 + known**2) @ axes), np.count_nonzero(known > 1)]
    return np.array(found)


def over_direct(scene: Scene, vertices: Floats, rays: Floats) -> NDArray[np.complex128]:
    """(N, P, F) hidden over direct light of surfaces (N, V, 3), which cast no shadows on themselves."""
    axes, origin = camera_axes(scene.camera), np.asarray(scene.camera.location_m)
    corners = (vertices[:, DIRECTIONS.faces] - origin) @ axes.T  # (N, T, 3, 3) in camera axes
    across = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    points, twice = corners.mean(axis=2), np.linalg.norm(across, axis=-1, keepdims=True)
    normals, areas = across / twice, twice[..., 0] / 2
    plane = plane_per_m(scene)
    film, area = film_rays(scene)
    lit, seen = (each / (each @ plane)[:, None] for each in (film, rays))  # points of the wall
    facing = -plane / np.linalg.norm(plane)
    turns, found = phase_per_metre(HZ), np.zeros((len(vertices), len(rays), len(HZ)), complex)
    occluder = Occluder.of(scene, axes)
    for one, (point, normal, part) in enumerate(zip(points, normals, areas, strict=True)):
        to, length = exchanged(lit, point, normal, facing, occluder)  # (L, T)
        from_camera = np.linalg.norm(lit, axis=1)
        back, length_back = exchanged(seen, point, normal, facing, occluder)  # (P, T)
        for frequency, turn in enumerate(turns):
            waves = to * np.exp(1j * turn * (length + from_camera[:, None]))
            sent = area @ waves * part / np.pi  # (T,)
            found[one, :, frequency] = (back * np.exp(1j * turn * length_back)) @ sent / np.pi
    z, distance = seen[:, 2] / np.linalg.norm(seen, axis=1), np.linalg.norm(seen, axis=1)
    cosine = np.abs(seen @ facing) / distance
    direct = cosine / (distance**2 * z**3)
    there = np.exp(1j * turns * distance[:, None])  # of the way to the wall, whose way back both have
    result: NDArray[np.complex128] = found / (direct[:, None] * there)
    return result


def exchanged(
    at: Floats, point: Floats, normal: Floats, facing: Floats, occluder: Occluder
) -> tuple[Floats, Floats]:
    """(M, T) cosines over squared distances between points of wall and surface, and the distances."""
    gap = point[None] - at[:, None]
    length = np.linalg.norm(gap, axis=-1)
    cosines = np.maximum(gap @ facing, 0) * np.maximum(-(gap * normal).sum(-1), 0) / length**2
    return cosines / length**2 * ~occluder.hides(at, point), length


@dataclass(frozen=True)
class Occluder:
    """The middle wall in camera axes: (3, 3) its own as columns, (3,) its middle, (2,) half its size."""

    turned: Floats
    middle_m: Floats
    half_m: Floats

    @classmethod
    def of(cls, scene: Scene, axes: Floats) -> Occluder:
        """That of a scene whose camera has the `axes`, as rows."""
        wall = scene.middle_wall
        middle_m = axes @ (np.asarray(wall.location_m) - scene.camera.location_m)
        return cls(axes @ rotation_matrix(wall.rotation_deg), middle_m, np.asarray(wall.size_m) / 2)

    def hides(self, at: Floats, point: Floats) -> NDArray[np.bool_]:
        """(M, T) whether it is between points (M, 3) and points (T, 3)."""
        one, two = ((each - self.middle_m) @ self.turned for each in (at[:, None], point))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = one[..., 2:] / (one[..., 2:] - two[..., 2:])
        meets = one + share * (two - one)
        hidden: NDArray[np.bool_] = (np.abs(meets[..., :2]) < self.half_m).all(-1)
        return hidden & (share[..., 0] > 0) & (share[..., 0] < 1)


def plane_per_m(scene: Scene) -> Floats:
    """(3,) the relay wall in camera axes, 1/m."""
    return WallView(**wall_geometry(scene.camera, scene.relay_wall)).plane_per_m


def film_rays(scene: Scene) -> tuple[Floats, Floats]:
    """(L, 3) rays of the projector at z = 1, and (L,) the film area of each: Gauss and Legendre."""
    (x, across), (y, down) = (np.polynomial.legendre.leggauss(count) for count in FILM)
    half = np.tan(np.radians(scene.camera.horizontal_fov_deg) / 2)
    place = np.stack(np.meshgrid(half * x, half * y * HEIGHT / WIDTH), axis=-1).reshape(-1, 2)
    area = np.outer(down, across).ravel() * half**2 * HEIGHT / WIDTH
    return np.concatenate([place, np.ones((len(place), 1))], axis=1), area


def depths_m(scene: Scene, vertices: Floats) -> Floats:
    """(N, P) radial depth of the mirror images of surfaces (N, V, 3)."""
    rays = pixel_rays(WIDTH, HEIGHT, scene.camera.horizontal_fov_deg).reshape(-1, 3)
    mirror = Mirror(scene.camera, plane_per_m(scene))
    start, away = mirror.points_m(np.zeros(1), rays[:1])[0], mirror.away(rays)
    nearest = np.stack([reach(start, away, each[DIRECTIONS.faces]).min(axis=1) for each in vertices])
    return np.where(np.isfinite(nearest), nearest, 0)


def reach(start: Floats, towards: Floats, triangles: Floats) -> Floats:
    """(R, T) distance along unit rays (R, 3) from a point to triangles (T, 3, 3); infinite beside them."""
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    gap = start - triangles[:, 0]
    across = np.cross(one, two)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = -1 / (towards @ across.T)  # (R, T), Möller and Trumbore 1997
        u, v = (towards @ np.cross(*pair).T * scale for pair in ((two, gap), (gap, one)))
        far = (gap * across).sum(-1) * scale
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0)
    return np.where(inside, far, np.inf)


def against_engine(scene: Scene) -> float:
    """Difference of the light of a sphere to that of the engine, relative to it."""
    (part, *_) = scene.hidden_objects
    round_one = replace(part, shape="sphere", size_m=(0.5, 0.5, 0.5), reflectance=1.0)
    scene = replace(
        scene,
        hidden_objects=(round_one,),
        relay_wall=replace(scene.relay_wall, roughness=None, reflectance=1.0, darkening=None),
    )
    rays = pixel_rays(WIDTH, HEIGHT, scene.camera.horizontal_fov_deg).reshape(-1, 3)
    engine = CandidateLight(HZ).over_direct([scene], rays, fine=True)[0]
    still = Surface(scene, np.full(len(DIRECTIONS.vertices), 0.25)).moved(
        np.zeros((1, 3 + (DEGREE + 1) ** 2))
    )
    own = over_direct(scene, still, rays)[0]
    return float(np.linalg.norm(own - engine) / np.linalg.norm(engine))


if __name__ == "__main__":
    main()
