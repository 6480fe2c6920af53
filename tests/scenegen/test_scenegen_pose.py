"""Poses computed without Blender have the numbers of Blender's own matrices, to the last bit."""

import itertools
from math import radians

import numpy as np
import pytest

from scenegen.mitsuba_description import seen_description
from scenegen.pose import blender_matrix, rotation_matrix
from scenegen.sampling import sample_scene

SPECIAL_DEG = (0.0, -0.0, 90.0, -90.0, 180.0, 45.0, 1e-8, 360.0)


@pytest.fixture(scope="module")
def blenders_own(maker):
    """Blender's `matrix_world` of a camera at a place, as (4, 4) numbers."""
    from scenegen.making.blender_start import bpy

    placed = bpy.data.objects.new("posed", bpy.data.cameras.new("posed"))
    placed.rotation_mode = "XYZ"
    bpy.context.scene.collection.objects.link(placed)

    def pose(location_m, rotation_deg):
        placed.location = location_m
        placed.rotation_euler = [radians(angle) for angle in rotation_deg]
        bpy.context.view_layer.update()
        return np.array(placed.matrix_world)

    yield pose
    bpy.data.batch_remove([placed, placed.data])


def test_a_pose_is_that_of_blender(blenders_own):
    rng = np.random.default_rng(4)
    rotations = [*itertools.product(SPECIAL_DEG, repeat=3), *rng.uniform(-720, 720, (2000, 3)).tolist()]
    for rotation_deg in rotations:
        location_m = tuple(rng.uniform(-1000, 1000, 3).tolist())
        expected = blenders_own(location_m, rotation_deg)
        np.testing.assert_array_equal(blender_matrix(location_m, rotation_deg), expected)


def test_a_pose_is_the_rotation_and_the_place():
    matrix = blender_matrix((1.0, -1.0, 1.65), (90.0, 20.0, 50.0))
    # Angles and entries are rounded to float32: 2^-24 of at most 1.6 rad each.
    np.testing.assert_allclose(matrix[:3, :3], rotation_matrix((90.0, 20.0, 50.0)), atol=3 * 1.6 * 2**-24)
    np.testing.assert_array_equal(matrix[:, 3], np.float32([1, -1, 1.65, 1]).astype(float))


def test_a_description_has_no_negative_zero(paper):
    scene = sample_scene(paper, 0)
    pose = np.array(seen_description(scene)["sensor"]["to_world"])
    assert not np.signbit(pose[pose == 0]).any()
