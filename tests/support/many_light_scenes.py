"""Corners to render in tests: the paper's camera, projector and walls around any meshes; measuring them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import trimesh

from itof import MeasurementMatrix, TransientLayout
from render.options import ManyLightOptions, PathOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.path_tracer import PathTracer

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
LAYOUT = TransientLayout(24, 18, 1400, 0.01, 0.0)
SMALL = TransientLayout(12, 9, 1400, 0.01, 0.0)

CAMERA_LOCATION_M = np.array([1.0, -1.0, 1.65])
FORWARD = np.array([-np.sin(np.radians(50)), np.cos(np.radians(50)), 0.0])
RIGHT, DOWN = np.array([FORWARD[1], -FORWARD[0], 0.0]), np.array([0.0, 0.0, -1.0])
HORIZONTAL_FOV_DEG = 60.0
PROJECTOR_FOV_DEG = 60.001  # wider than the camera's, as night-gen makes it
OBJECT_LOCATION_M = (1.15, 0.9, 1.6)
GAP_M = 0.7  # between the relay wall and the middle wall


def _one_scene(shapes, roughness, composite_fraction=0):
    """A preset of one scene whose object stands in the middle of its range."""
    location_m = {"x": [1.15, 1.15], "y": [0.9, 0.9], "z": [1.6, 1.6]}
    return {
        "dataset": {"count": 1, "seed": 3},
        "hidden_object": {
            "shapes": shapes,
            "composite_fraction": composite_fraction,
            "location_m": location_m,
        },
        "relay_wall": {"roughness": [roughness]},
        "camera": {"width": LAYOUT.width, "height": LAYOUT.height},
    }


# Presets of one scene each (fixture `four_shapes`): convex and concave, one part and two.
SHAPES = {
    "sphere": _one_scene(["sphere"], 0.3),
    "cube": _one_scene(["cube"], 0.6),
    "concave_plane": _one_scene(["concave_plane"], 0.9),
    "composite": _one_scene(["cone", "cylinder"], 0.6, 1),
}


def quad(*corners):
    """Two triangles; seen counter-clockwise from the side its normal points to."""
    return trimesh.Trimesh(np.array(corners, dtype=float), [[0, 1, 2], [0, 2, 3]], process=False)


def square(centre, normal, side_m):
    """A square around `centre`."""
    normal = np.array(normal) / np.linalg.norm(normal)
    u = np.cross([0, 0, 1], normal)
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    half = side_m / 2
    return quad(*(np.array(centre) + half * (a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))))


def ball(subdivisions=3, radius_m=0.28, centre=OBJECT_LOCATION_M):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m)
    return mesh.apply_translation(centre)


def box(extents_m=(0.5, 0.5, 0.5), centre=OBJECT_LOCATION_M, angle_rad=0.4):
    mesh = trimesh.creation.box(extents=extents_m)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(angle_rad, [1, 2, 3]))
    return mesh.apply_translation(centre)


def relay_wall(half_m=20.0):
    """The plane x = 0, centred at the camera's height, so that the scene can be symmetric in z."""
    y, z = (-half_m, half_m), (CAMERA_LOCATION_M[2] - half_m, CAMERA_LOCATION_M[2] + half_m)
    return quad((0, y[0], z[0]), (0, y[1], z[0]), (0, y[1], z[1]), (0, y[0], z[1]))


def middle_wall(half_m=20.0):
    low, high = CAMERA_LOCATION_M[2] - half_m, CAMERA_LOCATION_M[2] + half_m
    return quad((GAP_M, 0, low), (4, 0, low), (4, 0, high), (GAP_M, 0, high))


def two_sided(kind, **parameters):
    nested = {"type": kind} | {
        name: {"type": "uniform", "value": value} if "reflectance" in name else value
        for name, value in parameters.items()
    }
    return {"type": "twosided", "nested": nested}


DIFFUSE = two_sided("diffuse", reflectance=1.0)
BLACK = two_sided("diffuse", reflectance=0.0)


def rough_plastic(roughness):
    return two_sided("roughplastic", alpha=roughness, diffuse_reflectance=1.0)


@dataclass(frozen=True)
class Corner:
    """A scene to load.

    Attributes
    ----------
    hidden : meshes, or Mitsuba dictionaries for what is no mesh.
    moved : (4, 4) rigid motion of everything: camera, projector, walls, objects.
    emitter_turned_rad : turn of the projector about z.
    other_emitter : a Mitsuba dictionary instead of the projector.
    """

    hidden: tuple[Any, ...] = ()
    wall_bsdf: dict[str, Any] = field(default_factory=lambda: DIFFUSE)
    hidden_bsdf: dict[str, Any] = field(default_factory=lambda: DIFFUSE)
    blockers: tuple[trimesh.Trimesh, ...] = ()
    has_middle_wall: bool = True
    emitter_scale: float = 1.0
    emitter_turned_rad: float = 0.0
    other_emitter: dict[str, Any] | None = None
    camera_turned_rad: float = 0.0
    moved: np.ndarray = field(default_factory=lambda: np.eye(4))

    def but(self, **changes):
        return replace(self, **changes)

    def load(self, folder):
        import mitsuba as mi

        scene = {"type": "scene", "sensor": self._sensor(), "emitter": self._emitter()}
        black = {f"blocker_{number}": (mesh, BLACK) for number, mesh in enumerate(self.blockers)}
        if self.has_middle_wall:
            black["middle_wall"] = (middle_wall(), BLACK)
        hidden = {f"hidden_object_{n}": (mesh, self.hidden_bsdf) for n, mesh in enumerate(self.hidden)}
        walls = {"relay_wall": (relay_wall(), self.wall_bsdf)}
        for name, (mesh, bsdf) in (walls | black | hidden).items():
            scene[name] = self._shape(folder, name, mesh, bsdf)
        # optimize merges meshes of one material, and with them the ids that name what a ray met.
        return mi.load_dict(scene, optimize=False)

    def _shape(self, folder, name, mesh, bsdf):
        if isinstance(mesh, dict):
            return mesh | {"bsdf": bsdf}
        file = folder / f"{name}.ply"
        mesh.copy().apply_transform(self.moved).export(file)
        return {"type": "ply", "filename": str(file), "face_normals": True, "bsdf": bsdf}

    def _pose(self, turned_rad):
        import mitsuba as mi

        camera = np.eye(4)  # Mitsuba's camera: x left, y up, z forward
        camera[:3, :3] = np.stack([-RIGHT, -DOWN, FORWARD], axis=1)
        camera = trimesh.transformations.rotation_matrix(turned_rad, [0, 0, 1]) @ camera
        camera[:3, 3] = CAMERA_LOCATION_M
        return mi.ScalarTransform4f(self.moved @ camera)

    def _sensor(self):
        return {
            "type": "perspective",
            "fov_axis": "x",
            "fov": HORIZONTAL_FOV_DEG,
            "to_world": self._pose(self.camera_turned_rad),
            "film": {"type": "hdrfilm", "width": 24, "height": 18, "pixel_format": "luminance"},
        }

    def _emitter(self):
        import mitsuba as mi

        if self.other_emitter is not None:
            return self.other_emitter
        return {
            "type": "projector",
            "fov_axis": "x",
            "fov": PROJECTOR_FOV_DEG,
            "scale": self.emitter_scale,
            "to_world": self._pose(self.emitter_turned_rad),
            "irradiance": {
                "type": "bitmap",
                "bitmap": mi.Bitmap(np.ones((3, 4, 1), np.float32)),
                "raw": True,
                "filter_type": "nearest",
                "wrap_mode": "clamp",
            },
        }


def expose(
    scene, variant, *, lights=1024, seed=1, layout=LAYOUT, max_bounces=3, frequencies_hz=FREQUENCIES_HZ
):
    view = View(layout, frequencies_hz, max_bounces, seed)
    return ManyLight(ManyLightOptions(lights=lights), variant).expose(scene, view)


def measure(scene, variant, **options):
    return expose(scene, variant, **options).phasors()


def path_phasors(scene, variant, *, seeds, spp, layout=LAYOUT, max_bounces=3):
    """(runs, H, W, F) phasors by path tracing, Φ of their bins."""
    phi = MeasurementMatrix(FREQUENCIES_HZ, layout.bin_count, layout.bin_width_m, splat="quadratic")
    method = PathTracer(PathOptions(spp=spp), variant)
    views = (View(layout, FREQUENCIES_HZ, max_bounces, seed) for seed in seeds)
    return np.array([phi.apply_streaming(method.expose(scene, view).row_blocks()) for view in views])


def relative(z, reference):
    """‖z - reference‖ / ‖reference‖ over the image, per frequency."""
    axes = (-3, -2)
    return np.linalg.norm(z - reference, axis=axes) / np.linalg.norm(reference, axis=axes)


def assert_agrees_with_paths(image, runs):
    """The sums agree within 5 sigma, and pixels differ by the noise of the path tracer's `runs`."""
    hidden = runs - image.direct
    count = len(runs)
    total = image.hidden.sum(axis=(0, 1))
    sums = hidden.sum(axis=(1, 2)) / total  # (runs, F), 1 where both agree
    for part, expected in ((sums.real, 1), (sums.imag, 0)):
        sigma = part.std(axis=0, ddof=1) / np.sqrt(count)
        # Student's t with 11 degrees of freedom passes 5 once in 2500; six correlated looks.
        assert np.all(np.abs(part.mean(axis=0) - expected) < 5 * sigma + 1e-3)
    variance = (hidden.real.var(axis=0, ddof=1) + hidden.imag.var(axis=0, ddof=1)) / count  # (H, W, F)
    squared = np.abs(hidden.mean(axis=0) - image.hidden) ** 2
    # The sum of squares has the mean sum(v). Real and imaginary part may be one number, then each pixel
    # scatters by sqrt(2) v; estimating v from few runs adds 2 / (runs - 1) to the 2.
    scatter = np.sqrt((2 + 2 / (count - 1)) * (variance**2).sum(axis=(0, 1))) / variance.sum(axis=(0, 1))
    chi = squared.sum(axis=(0, 1)) / variance.sum(axis=(0, 1))
    # What every pixel shares, the lights' own error of at most 1 %, adds its square over the noise's.
    noise = np.sqrt(variance.sum(axis=(0, 1))) / np.linalg.norm(image.hidden, axis=(0, 1))
    assert np.all(np.abs(chi - 1) < 4 * scatter + (0.01 / noise) ** 2)
