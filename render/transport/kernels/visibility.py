"""Occlusion between two points on surfaces. Import this module late, after a Mitsuba variant is set.

Mitsuba's own shadow rays start about 0.4 mm above a surface and stop 0.1 % before the other end, 1 mm in
these scenes. Light then leaks through thin shells and around sharp edges. These rays start and stop a few
roundings of float32 away from both surfaces.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# Distance from the surface per metre of the largest coordinate (plus 1 m): 32 float32 roundings. Points and
# intersections have errors of a few roundings.
_STEP = 2.0**-19


def unoccluded(
    scene: mi.Scene,
    a: mi.Point3f,
    a_normal: mi.Normal3f,
    b: mi.Point3f,
    b_normal: mi.Normal3f,
    active: mi.Bool,
) -> mi.Bool:
    """Whether nothing lies between points a and b, which lie on surfaces with these normals.

    The direction of a normal does not matter: the ray is on the side of each surface that faces the other
    point. The result is False where `active` is.
    """
    start, end = lifted(a, a_normal, b), lifted(b, b_normal, a)
    gap = end - start
    distance = dr.norm(gap)
    return active & ~scene.ray_test(mi.Ray3f(start, gap / distance, distance, 0, []), active)


def lifted(point: mi.Point3f, normal: mi.Normal3f, towards: mi.Point3f) -> mi.Point3f:
    """A point just above its surface, on the side of `towards`."""
    return point + normal * dr.copysign(clearance(point), dr.dot(normal, towards - point))


def clearance(point: mi.Point3f) -> mi.Float:
    """Distance (metres) above which two places near a point differ by more than rounding."""
    return _STEP * (1 + dr.max(dr.abs(point)))
