"""The points of hidden surfaces, and what is inside them, against closed forms and meshes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from render.batch.surface_points import surface_points
from render.batch.tables import PlacedObject
from scenegen.preset import ShapeSizes
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
@pytest.mark.parametrize("level", [1, 4])
def test_points_have_the_area_and_the_volume_of_the_solid(shape, level):
    unit, size = surface_points(shape, level, unit_mesh(shape)), np.array(ShapeSizes().of(shape))
    turned = unit.normals / size
    length = np.linalg.norm(turned, axis=1)
    areas = unit.areas * size.prod() * length
    assert areas.sum() == pytest.approx(AREAS_M2[shape], rel=2e-3)  # the chord of a sheet has three digits
    flux = (unit.points * size * turned / length[:, None]).sum(1) @ areas  # Gauss: three volumes
    assert flux == pytest.approx(3 * VOLUMES_M3[shape], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_the_inside_is_that_of_the_mesh(shape):
    size, rng = np.array(ShapeSizes().of(shape)), np.random.default_rng(6)
    axes, centre = Rotation.random(random_state=1).as_matrix(), np.array([0.3, -0.2, 2.0])
    points = centre + rng.uniform(-0.4, 0.4, (3000, 3))
    found = PlacedObject(0, shape, axes, centre, size, 1.0).contains(points)
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
