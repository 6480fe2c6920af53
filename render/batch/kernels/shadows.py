"""What objects hide from each other. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

from typing import Final

import drjit as dr
import mitsuba as mi

from render.batch.quadrics import Hiding

FARTHEST_M: Final = 1024.0  # that a mirror image can be away
_BOX, _SOLID, _SHEET, _MESH = map(int, Hiding)  # DrJit takes plain numbers
_PARALLEL = 1e-12  # a way along a side of a box
_ROOMY = 0.5 + 1e-3  # half the box of a unit mesh in which rays are cast
_QUAD = mi.Vector4f


class Shadows:
    """What can hide light: the objects of each scene of the batch.

    Primitives are closed forms: a quadric in the box of their unit mesh (`render.batch.quadrics`).
    Rays are cast for the user's meshes, and for the depth of every object's facets.

    Attributes
    ----------
    world : the unit meshes, each in a cell of its own.
    first, last : (N,) the objects of each scene that can hide light from it; none where none can.
    objects : of each object, three rows of the affine map from camera axes to those of its unit mesh, and the
        place of the unit mesh in `world`; two rows of the quadric.
    has_meshes : whether any object is a user's mesh.
    """

    ROWS = 6  # groups of four

    def __init__(
        self, world: mi.Scene, first: mi.UInt32, last: mi.UInt32, objects: mi.Float, has_meshes: bool
    ) -> None:
        self.world, self.first, self.last, self.objects = world, first, last, objects
        self.has_meshes = has_meshes

    def meets(self, index: mi.UInt32, point: mi.Point3f, to: mi.Vector3f, active: mi.Bool) -> mi.Bool:
        """Whether an object lies between a point and the one at `to` from it."""
        origin, along, enters, leaves = self._in_box(index, point, to)
        inside = enters < leaves
        one, two = (dr.gather(_QUAD, self.objects, index * self.ROWS + row) for row in (4, 5))
        squares, linear, kind = mi.Vector3f(one.x, one.y, one.z), mi.Vector3f(one.w, 0, two.x), two.z
        a = dr.dot(squares * along, along)
        b = dr.dot(squares * origin, along) + dr.dot(linear, along) / 2
        c = dr.dot(squares * origin, origin) + dr.dot(linear, origin) + two.y
        root = dr.sqrt(dr.maximum(dr.square(b) - a * c, 0))
        scale = dr.rcp(dr.select(dr.abs(a) < _PARALLEL, _PARALLEL, a))
        near, far = (-b - root) * scale, (-b + root) * scale
        near, far = dr.minimum(near, far), dr.maximum(near, far)
        crossed = ((near > enters) & (near < leaves)) | ((far > enters) & (far < leaves))
        # A steep way through a double cone is inside before `near` and after `far`; the tip is up.
        steep, upwards = a < 0, along.z > 0
        low = dr.select(steep, dr.select(upwards, -dr.inf, far), near)
        high = dr.select(steep, dr.select(upwards, near, dr.inf), far)
        within = dr.maximum(low, enters) < dr.minimum(high, leaves)
        real = dr.square(b) >= a * c
        met = (kind == _SOLID) & dr.select(real, within, steep)
        met |= (kind == _BOX) | ((kind == _SHEET) & real & crossed)
        if self.has_meshes:
            origin, along, enters, leaves = self._in_box(index, point, to, _ROOMY)
            casts = (enters < leaves) & (kind == _MESH)
            ray = self._ray(index, origin, along, enters, leaves)
            return (inside & met) | (casts & self.world.ray_test(ray, active & casts))
        return inside & met

    def depth(self, index: mi.UInt32, point: mi.Point3f, ray: mi.Vector3f) -> mi.Float:
        """Distance of an object along a unit ray, metres; `FARTHEST_M` where the ray misses it."""
        origin, along, enters, leaves = self._in_box(index, point, ray * FARTHEST_M, _ROOMY)
        inside = enters < leaves
        way = self._ray(index, origin, along, enters, leaves)
        hit = self.world.ray_intersect_preliminary(way, coherent=True, active=inside)
        return dr.select(inside & hit.is_valid(), (enters + hit.t) * FARTHEST_M, FARTHEST_M)

    def _in_box(
        self, index: mi.UInt32, point: mi.Point3f, to: mi.Vector3f, half: float = 0.5
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float, mi.Float]:
        """A way in the axes of an object's unit mesh, and its part in a box of such half extents."""
        rows = [dr.gather(_QUAD, self.objects, index * self.ROWS + row) for row in range(3)]
        axes = [mi.Vector3f(row.x, row.y, row.z) for row in rows]
        origin = mi.Point3f(*(dr.dot(axis, point) + row.w for axis, row in zip(axes, rows, strict=True)))
        along = mi.Vector3f(*(dr.dot(axis, to) for axis in axes))
        inverse = dr.rcp(dr.select(dr.abs(along) < _PARALLEL, _PARALLEL, along))
        one, two = (-half - origin) * inverse, (half - origin) * inverse
        enters = dr.maximum(dr.max(dr.minimum(one, two)), 0)
        return origin, along, enters, dr.minimum(dr.min(dr.maximum(one, two)), 1)

    def _ray(
        self, index: mi.UInt32, origin: mi.Point3f, along: mi.Vector3f, enters: mi.Float, leaves: mi.Float
    ) -> mi.Ray3f:
        """The part of a way in a box, in the cell of its unit mesh; lengths are shares of the way."""
        row = dr.gather(_QUAD, self.objects, index * self.ROWS + 3)
        start = origin + enters * along + mi.Vector3f(row.x, row.y, row.z)
        return mi.Ray3f(start, along, dr.maximum(leaves - enters, 0), 0.0, [])  # negative: counts as a hit


@dr.syntax
def in_shadow(
    shadows: Shadows, scene: mi.UInt32, point: mi.Point3f, own: mi.UInt32, to: mi.Vector3f, active: mi.Bool
) -> mi.Bool:
    """Whether an object of the scene, but not the point's `own`, lies between a point and the one at `to`."""
    index, last = dr.gather(mi.UInt32, shadows.first, scene), dr.gather(mi.UInt32, shadows.last, scene)
    index += dr.select(index == own, 1, 0)
    dark = mi.Bool(False)
    while active & (index < last) & ~dark:
        dark = shadows.meets(index, point, to, active)
        index += dr.select(index + 1 == own, 2, 1)
    return dark
