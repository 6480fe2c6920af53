"""The points of hidden surfaces, and what is inside them, against closed forms and meshes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.batch.free_surface import free_parts
from render.batch.surface_points import longer_sides, surface_points
from render.batch.tables import PlacedObject
from scenegen.object_settings import ShapeSizes
from scenegen.shapes import PRIMITIVES
from scenegen.unit_meshes import unit_mesh

AREAS_M2 = {
    "cube": 6 * 0.5**2,
    "parallelepiped": 2 * (0.3**2 + 2 * 0.3 * 0.6),
    "sphere": np.pi * 0.56**2,
    "cylinder": np.pi * 0.4 * 0.55 + 2 * np.pi * 0.2**2,
    "cone": np.pi * 0.28 * np.hypot(0.28, 0.55) + np.pi * 0.28**2,
    "concave_plane": 2 * 0.589 / np.sin(1) * 0.6,  # both sides of an arc of 2 rad of radius chord / 2 sin(1)
}
VOLUMES_M3 = {
    "cube": 0.5**3,
    "parallelepiped": 0.3 * 0.3 * 0.6,
    "sphere": np.pi / 6 * 0.56**3,
    "cylinder": np.pi * 0.2**2 * 0.55,
    "cone": np.pi / 3 * 0.28**2 * 0.55,
    "concave_plane": 0.0,
}


@pytest.mark.parametrize("shape", PRIMITIVES)
@pytest.mark.parametrize(("level", "longer"), [(1, (0, 0, 0)), (4, (0, 0, 0)), (1, (2, 0, 3))])
def test_points_have_the_area_and_the_volume_of_the_solid(shape, level, longer):
    unit, size = surface_points(shape, level, unit_mesh(shape), longer), np.array(ShapeSizes().of(shape))
    turned = unit.normals / size
    length = np.linalg.norm(turned, axis=1)
    areas = unit.areas * size.prod() * length
    assert areas.sum() == pytest.approx(AREAS_M2[shape], rel=2e-3)  # the chord of a sheet has three digits
    flux = (unit.points * size * turned / length[:, None]).sum(1) @ areas  # Gauss: three volumes
    assert flux == pytest.approx(3 * VOLUMES_M3[shape], rel=1e-9, abs=1e-12)


def test_long_sides_have_more_points_and_the_papers_solids_none():
    for shape in PRIMITIVES:
        assert longer_sides(shape, np.array(ShapeSizes().of(shape))) == (0, 0, 0)
        assert longer_sides(shape, np.array([0.25, 0.45, 1.7])) == (0, 0, 2)
        assert longer_sides(shape, np.array([1e-4, 1e-4, 1000])) == (0, 0, 6)  # not all of the memory
        usual, more = (surface_points(shape, 1, unit_mesh(shape), (0, 0, each)) for each in (0, 2))
        assert 1.2 < len(more.areas) / len(usual.areas) < 2.3  # not along x and y


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_the_inside_is_that_of_the_mesh(shape):
    size, rng = np.array(ShapeSizes().of(shape)), np.random.default_rng(6)
    axes, centre = Rotation.random(random_state=1).as_matrix(), np.array([0.3, -0.2, 2.0])
    points = centre + rng.uniform(-0.4, 0.4, (3000, 3))
    solid = PlacedObject(0, shape, axes, centre, size, 1.0)
    facing = np.broadcast_to([0.0, 0.0, 1.0], (1, 3000, 3))
    free, _ = free_parts(points[None], facing, np.full((1, 3000), 1e-12), [[solid]])
    found = free[0] < 0.5  # of parts that are small: all or nothing
    if shape == "concave_plane":
        assert not found.any()
        return
    mesh = unit_mesh(shape)
    own = (points - centre) @ axes / size
    corners = mesh.vertices[mesh.triangles].astype(float)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    depth = ((own[:, None] - corners[:, 0]) * outward).sum(-1).max(1)  # below 0 inside: the mesh is convex
    chord = 2e-3  # of the extents: facets are so far inside round surfaces, at most
    clear = (depth < 0) | (depth > chord)
    assert (found[clear] == (depth[clear] < 0)).all()
    assert 30 < found.sum() < 3000


CUBE_SHIFT_M, SPHERES_APART_M, SPHERE_RADIUS_M = np.array([0.2, 0.1, 0.3]), 0.2, 0.28
FREE_M2 = {
    "cube": 6 * 0.5**2 - sum(np.prod(np.delete(0.5 - CUBE_SHIFT_M, axis)) for axis in range(3)),
    "sphere": 2 * np.pi * SPHERE_RADIUS_M * (SPHERE_RADIUS_M + SPHERES_APART_M / 2),  # without a cap
}


@pytest.mark.parametrize("shape", FREE_M2)
def test_what_is_free_of_intersecting_solids_has_the_area_of_the_closed_form(shape):
    # Parts at the edge of the other solid, of the width w, are off by w²/4 at most if they are turned by 45
    # degrees, either way; they are some L / w along an edge of the length L, so the sum is off by less than
    # w L / 4 / sqrt(L / w).
    turn, size = Rotation.random(random_state=2).as_matrix(), np.array(ShapeSizes().of(shape))
    unit = surface_points(shape, 6, unit_mesh(shape))
    away = turn @ (CUBE_SHIFT_M if shape == "cube" else np.array([SPHERES_APART_M, 0, 0]))
    other = PlacedObject(0, shape, turn, away, size, 1.0)
    at, area = (unit.points * size) @ turn.T, unit.areas * size[0] ** 2
    free, middle = free_parts(at[None], (unit.normals @ turn.T)[None], area[None], [[other]])
    width, edge = np.sqrt(area.max()), 2.5  # metres: the edges of the cut are shorter
    assert (free[0] @ area) == pytest.approx(FREE_M2[shape], abs=width**1.5 * edge**0.5 / 4)
    shifted = np.linalg.norm(middle[0] - at, axis=1)
    assert (shifted <= width / 2).all()
    assert (shifted[free[0] == 1] == 0).all()


def test_of_several_solids_the_one_that_hides_most_counts():
    size = np.array([0.5, 0.5, 0.5])
    solids = [PlacedObject(0, "cube", np.eye(3), np.array([x, 0.0, 0.0]), size, 1.0) for x in (0.25, -0.1)]
    at = np.array([[[0.1, 0.0, 0.0], [0.4, 0.0, 0.0], [0.7, 0.0, 0.0], [-0.3, 0.0, 0.0]]])
    up = np.broadcast_to([0.0, 0.0, 1.0], at.shape)
    area = np.full((1, 4), 1e-12)
    free, _ = free_parts(
        np.repeat(at, 2, 0), np.repeat(up, 2, 0), np.repeat(area, 2, 0), [solids, solids[:1]]
    )
    assert free.tolist() == [[0, 0, 1, 0], [0, 0, 1, 1]]
