"""The scenes of a batch as the flat arrays of `render.batch.kernels`."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, radians, sin
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from itof import phase_per_metre
from render.backend import Device, select_variant
from render.batch.quadrics import Hiding, is_convex, quadric_of
from render.walls.corners import Corners
from scenegen.mitsuba_description import ROUGH_WALL_INDEX
from scenegen.pose import rotation_matrix
from scenegen.scene import HiddenObject, RelayWall, Scene
from scenegen.shapes import PRIMITIVES, Shape
from scenegen.unit_meshes import UnitMesh, unit_mesh

if TYPE_CHECKING:
    import mitsuba as mi

Floats = NDArray[np.float64]
_ROUGHNESS_STEP = 0.05  # of the surfaces that are mixed
_CELL = 4.0  # distance of the unit meshes in their scene, in units of their box
_MOST_BOXES = 4096  # that are kept
_GRID = np.stack(np.meshgrid(*[[-0.5, 0.0, 0.5]] * 3), -1).reshape(-1, 3)


@dataclass(frozen=True)
class PlacedObject:
    """A hidden object in camera axes: (3, 3) own axes as columns, centre and extents in metres."""

    scene: int
    shape: Shape
    axes: Floats
    centre: Floats
    size: Floats
    reflectance: float

    @classmethod
    def of(cls, number: int, part: HiddenObject, camera_axes: Floats, camera_m: Floats) -> PlacedObject:
        """An object of the scene `number` of a batch."""
        axes = camera_axes @ rotation_matrix(part.rotation_deg)
        centre = camera_axes @ (np.array(part.location_m) - camera_m)
        return cls(number, part.shape, axes, centre, np.array(part.size_m), part.reflectance)

    @property
    def near_points(self) -> Floats:
        """(27, 3) corners and middles of its box."""
        points: Floats = (_GRID * self.size) @ self.axes.T + self.centre
        return points

    def rows(self, cell: int) -> Floats:
        """(6, 4) numbers of `kernels.shadows.Shadows`."""
        return rows_of(self.shape, cell, self.axes, self.centre, self.size)


def rows_of(shape: Shape, cell: int, axes: Floats, centre: Floats, size: Floats) -> Floats:
    """(..., 6, 4) numbers of `kernels.shadows.Shadows` of solids of one shape, placed as a `PlacedObject`.

    `axes` is (..., 3, 3), `centre` and `size` are (..., 3), in camera axes.
    """
    rows = np.zeros((*centre.shape[:-1], 6, 4))
    rows[..., :3, :3] = np.swapaxes(axes / size[..., None, :], -1, -2)
    rows[..., :3, 3] = -np.einsum("...ij,...j->...i", rows[..., :3, :3], centre)
    rows[..., 3, 0] = _CELL * cell
    quadric, hiding = quadric_of(shape)
    rows[..., 4, :], rows[..., 5, :3] = quadric[:4], (*quadric[4:], hiding)
    return rows


def rotated(axes: Floats, vectors: Floats) -> Floats:
    """Vectors (n, S, 3) turned by matrices (n, 3, 3): the same bits in any batch, unlike with `einsum`."""
    x, y, z = np.moveaxis(vectors[..., None], -2, 0)
    turned: Floats = axes[:, None, :, 0] * x + axes[:, None, :, 1] * y + axes[:, None, :, 2] * z
    return turned


@dataclass(frozen=True)
class Scenes:
    """N scenes, ready for the kernels.

    Attributes
    ----------
    scenes : as plain data.
    different : their corners, each once, and `boxes` of these (`Corners.box`); `corner` (N,) is that of each
        scene.
    objects : all hidden objects, scene by scene.
    first_object : (N + 1,) of each scene.
    batch : the arrays of the kernels.
    """

    scenes: Sequence[Scene]
    different: Corners
    boxes: Floats
    corner: NDArray[np.int64]
    objects: list[PlacedObject]
    first_object: NDArray[np.int64]
    batch: Any

    @cached_property
    def corners(self) -> Corners:
        """The N corners."""
        return self.different.some(self.corner)

    @cached_property
    def box(self) -> Floats:
        """(N, 4) the part of each image that shows the relay wall (`Corners.box`)."""
        return self.boxes[self.corner]

    def objects_of(self, scene: int) -> list[PlacedObject]:
        """The hidden objects of a scene."""
        return self.objects[self.first_object[scene] : self.first_object[scene + 1]]


class World:
    """The unit meshes of all shapes that scenes may have, in one Mitsuba scene that is made once.

    Parameters
    ----------
    meshes : of the user, by shape.
    device : ``auto``, ``cpu`` or ``cuda``.
    threads : of DrJit on the CPU, in this process; None keeps their number.
    mixes_roughness : whether the surface of rough walls is mixed from those with the roughness 0.05, 0.1 and
        so on, as a search needs that has another roughness in each scene.

    Raises
    ------
    BackendError : this machine cannot render on the requested device.
    """

    def __init__(
        self,
        meshes: Mapping[Shape, UnitMesh] | None,
        device: Device,
        threads: int | None = None,
        *,
        mixes_roughness: bool = False,
    ) -> None:
        self.meshes = {shape: unit_mesh(shape) for shape in PRIMITIVES} | dict(meshes or {})
        self._variant, self._mixes_roughness = select_variant(device), mixes_roughness
        import drjit as dr

        if threads is not None:
            dr.set_thread_count(threads)
        self.cells = {shape: cell for cell, shape in enumerate(self.meshes)}
        self.scene = _mesh_scene(list(self.meshes.values()))
        self._boxes = _Boxes({})

    def scenes(self, scenes: Sequence[Scene], frequencies_hz: Sequence[float]) -> Scenes:
        """The arrays of some scenes."""
        import drjit as dr
        import mitsuba as mi

        from render.batch.kernels.shadows import Shadows
        from render.batch.kernels.wall import Batch
        from render.transport.kernels.arrays import upload, upload_indices

        different, corner, keys = _different_corners(scenes)
        corners = different.some(corner)
        objects = [
            PlacedObject.of(number, part, corners.axes[number], corners.origin[number])
            for number, scene in enumerate(scenes)
            for part in scene.hidden_objects
        ]
        counts = np.array([len(scene.hidden_objects) for scene in scenes])
        first = np.concatenate([[0], np.cumsum(counts)])
        shadowing = [_can_be_in_shadow(scene) for scene in scenes]
        rows = [placed.rows(self.cells[placed.shape]) for placed in objects]
        rows = rows or [np.zeros((Shadows.ROWS, 4))]  # of no scene: the kernels need an array
        last = np.where(shadowing, first[1:], first[:-1])
        shadows = Shadows(
            *(self.scene, upload_indices(first[:-1]), upload_indices(last), upload(np.stack(rows))),
            any(quadric_of(shape)[1] is Hiding.MESH for shape in self.cells),
        )
        walls, transmittance = self._walls(scenes, corners)
        turns = [dr.opaque(mi.Float, float(k)) for k in phase_per_metre(frequencies_hz)]
        batch = Batch(upload(walls), upload(transmittance), turns, shadows)
        return Scenes(scenes, different, self._boxes.of(keys, different), corner, objects, first, batch)

    def _walls(self, scenes: Sequence[Scene], corners: Corners) -> tuple[Floats, Floats]:
        """(N, 24) numbers of `kernels.wall.Wall`, and (N, COSINES) what passes the surface, by cosine."""
        from render.transport.kernels.rough_wall import COSINES

        count = len(scenes)
        rows, transmittance = np.zeros((count, 6, 4)), np.ones((count, COSINES))
        alpha, base, gloss = np.full(count, 0.5), np.full(count, 1 / np.pi), np.zeros(count)
        for number, scene in enumerate(scenes):
            roughness = scene.relay_wall.roughness
            if roughness is not None:
                transmittance[number], internal = self._surface(roughness)
                alpha[number], gloss[number] = roughness, 1.0
                base[number] = 1 / (np.pi * ROUGH_WALL_INDEX**2 * (1 - internal))
            rows[number, 1] = _brightness(scene.relay_wall, corners.axes[number], corners.origin[number])
        middle = corners.middle
        rows[:, 0, :3], rows[:, 0, 3] = corners.normal, alpha
        rows[:, 2, :3], rows[:, 2, 3] = middle.corner, base
        rows[:, 3, :3], rows[:, 3, 3] = _dual(middle.one), gloss
        rows[:, 4, :3], rows[:, 4, 3] = _dual(middle.two), 1 / np.linalg.norm(corners.plane, axis=1)
        rows[:, 5, :3] = middle.across
        return rows.reshape(count, -1), transmittance

    def _surface(self, roughness: float) -> tuple[Floats, float]:
        """What passes the surface of a rough wall, by cosine, and what it sends back of the base's light."""
        from render.transport.kernels.rough_wall import surface_tables

        if not self._mixes_roughness:
            return surface_tables(self._variant, roughness)
        step = int(roughness / _ROUGHNESS_STEP)
        share = roughness / _ROUGHNESS_STEP - step
        (passed, internal), (more_passed, more_internal) = (
            surface_tables(self._variant, round(each * _ROUGHNESS_STEP, 9)) for each in (step, step + 1)
        )
        return passed + share * (more_passed - passed), internal + share * (more_internal - internal)


@dataclass(frozen=True)
class _Boxes:
    """The boxes of corners by their keys: a search comes back to the same few corners in each step."""

    known: dict[Hashable, Floats]

    def of(self, keys: Sequence[Hashable], corners: Corners) -> Floats:
        """(N, 4) `Corners.box` of corners with these keys."""
        new = [place for place, key in enumerate(keys) if key not in self.known]
        if len(self.known) + len(new) > _MOST_BOXES:
            self.known.clear()
            new = list(range(len(keys)))
        if new:
            self.known.update(
                zip([keys[place] for place in new], corners.some(np.array(new)).box(), strict=True)
            )
        return np.stack([self.known[key] for key in keys])


def _different_corners(scenes: Sequence[Scene]) -> tuple[Corners, NDArray[np.int64], list[Hashable]]:
    """The corners of scenes, each once, which one each scene has, and a key of each corner."""
    number: dict[Hashable, int] = {}
    different: list[Scene] = []
    corner = []
    for scene in scenes:
        relay = scene.relay_wall
        key = (scene.camera, relay.location_m, relay.rotation_deg, relay.size_m, scene.middle_wall)
        if key not in number:
            number[key] = len(different)
            different.append(scene)
        corner.append(number[key])
    return Corners.of(different), np.array(corner), list(number)


def _mesh_scene(meshes: Sequence[UnitMesh]) -> mi.Scene:
    """A Mitsuba scene of unit meshes, each in its own cell."""
    import mitsuba as mi

    counts = [len(mesh.vertices) for mesh in meshes]
    first = np.concatenate([[0], np.cumsum(counts)])
    vertices = [mesh.vertices + np.array([_CELL * cell, 0, 0]) for cell, mesh in enumerate(meshes)]
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)]
    made = mi.Mesh("unit_meshes", int(first[-1]), sum(map(len, triangles)))
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(np.concatenate(vertices).astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(np.concatenate(triangles).astype(np.uint32).ravel())
    parameters.update()
    return mi.load_dict({"type": "scene", "unit_meshes": made})


def _can_be_in_shadow(scene: Scene) -> bool:
    """Whether an object can hide light from itself or from another one: only a single convex solid cannot."""
    shapes = [part.shape for part in scene.hidden_objects]
    return len(shapes) > 1 or not all(map(is_convex, shapes))


def _dual(edges: Floats) -> Floats:
    """(N, 3) vectors whose product with an edge (N, 3) is 1."""
    dual: Floats = edges / (edges**2).sum(-1, keepdims=True)
    return dual


def _brightness(wall: RelayWall, camera_axes: Floats, camera_m: Floats) -> Floats:
    """(4,) w and c of the wall's reflectance w · p + c at its points p, in camera axes."""
    if wall.darkening is None:
        return np.array([0, 0, 0, wall.reflectance])
    angle = radians(wall.darkening.direction_deg)
    step = np.array([cos(angle), sin(angle)]) * wall.size_m
    own = (camera_axes @ rotation_matrix(wall.rotation_deg))[:, :2]  # columns: x and y of the wall
    slope = own @ (step / np.abs(step).sum() / wall.size_m)
    centre = camera_axes @ (np.array(wall.location_m) - camera_m)
    change = wall.darkening.least_reflectance - wall.reflectance
    return np.append(change * slope, wall.reflectance + change * (0.5 - slope @ centre))
