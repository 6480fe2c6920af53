"""Blender's view of a scene from outside."""

import dataclasses

import numpy as np
import pytest
from previews import orange

from scenegen import sample_scene
from scenegen.making.blender_start import bpy

SIZE = (144, 108)  # of the view: a small object still covers 30 pixels


@pytest.fixture(scope="module")
def cube(paper):
    """An upright cube in the middle of its range."""
    scene = sample_scene(paper, 0)
    assert scene.object_class == "cube"
    return moved(scene, location_m=(1.15, 0.9, 1.6), rotation_deg=(0.0, 0.0, 0.0))


def moved(scene, **changes):
    return dataclasses.replace(
        scene, hidden_objects=(dataclasses.replace(scene.hidden_objects[0], **changes),)
    )


@pytest.mark.long
def test_the_view_shows_the_object_where_it_is(maker, cube):
    rows, columns = orange(maker.picture(cube, *SIZE)).T
    assert len(rows) > 30
    for location_m, moves in (
        ((1.15, 1.2, 1.6), (0, 1)),  # away from the middle wall is to the right
        ((1.15, 0.6, 1.6), (0, -1)),
        ((1.15, 0.9, 1.9), (-1, 0)),
    ):
        there = orange(maker.picture(moved(cube, location_m=location_m), *SIZE)).mean(axis=0)
        shift = there - (rows.mean(), columns.mean())
        along = shift @ moves
        assert along > 5
        assert along > np.linalg.norm(shift) * np.cos(np.radians(35))  # the view is oblique


def test_without_an_object_nothing_in_the_view_has_its_colour(maker, cube):
    tiny = moved(cube, size_m=(1e-4, 1e-4, 1e-4))
    picture = maker.picture(tiny, *SIZE)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    assert len(orange(picture)) == 0
    red, blue = picture[..., 0].astype(int), picture[..., 2].astype(int)
    assert 0.05 < (blue > red + 60).mean() < 0.5  # the lit part of the wall


def test_a_wider_camera_lights_more_of_the_wall(maker, cube):
    blue = []
    for angle in (20.0, 40.0):
        camera = dataclasses.replace(cube.camera, horizontal_fov_deg=angle)
        picture = maker.picture(dataclasses.replace(cube, camera=camera), *SIZE).astype(int)
        blue.append((picture[..., 2] > picture[..., 0] + 60).mean())
    assert blue[1] > 2 * blue[0]


def test_the_viewpoint_is_the_same_for_all_scenes(maker, cube):
    near, far = (maker.picture(moved(cube, location_m=(1.15, y, 1.6)), *SIZE) for y in (0.6, 1.3))
    corner = np.s_[:36, :36]  # relay wall, far from objects and their shadows
    np.testing.assert_allclose(near[corner].astype(int), far[corner], atol=4)


def test_a_view_leaves_nothing_behind(maker, cube, capfd):
    collections = ("scenes", "worlds", "objects", "cameras", "lights", "materials", "images", "meshes")
    before = {name: len(getattr(bpy.data, name)) for name in collections}
    engine = bpy.context.scene.render.engine
    files = maker.files(cube)
    first = maker.picture(cube, *SIZE)
    assert maker.files(cube) == files
    assert {name: len(getattr(bpy.data, name)) for name in collections} == before
    assert bpy.context.scene.render.engine == engine
    np.testing.assert_array_equal(maker.picture(cube, *SIZE), first)
    assert capfd.readouterr() == ("", "")
