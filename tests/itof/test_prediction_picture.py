"""The picture of a prediction: the room from above is where the mirror trick has it, colours mean numbers."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import ImageDraw
from scipy.spatial.transform import Rotation

from itof import DepthMap, pixel_rays
from itof.pictures.plan import Plan, Room
from itof.pictures.prediction_picture import Scale, View, draw_prediction

HEIGHT, WIDTH, FOV_DEG = 6, 9, 70.0
ABOVE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # a level camera looks along y
PLANE = np.array([-0.2, 0.0, 0.5])


def seen(depth_m, mask):
    """A prediction (H, W) with errors that grow with the depth."""
    return replace(DepthMap.of_object(np.where(mask, depth_m, 0.0), mask, 20e6), depth_error_m=depth_m / 100)


def view(depth_m, shape=(HEIGHT, WIDTH)):
    """What a picture shows of an object at a depth (H, W) in the middle of the image."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    mask = (abs(rows - shape[0] // 2) < 2) & (abs(columns - shape[1] // 2) < 3)
    one = seen(np.broadcast_to(depth_m, shape).astype(float), mask)
    plan = Plan.of(one, Room(ABOVE, PLANE), FOV_DEG)
    return View("a file", one, np.linspace(0, 3, mask.size).reshape(shape), "light", plan)


@pytest.mark.parametrize("pose", [(0, 0, 0), (40, 0, 0), (0, 25, 8), (200, -30, -15)], ids=str)
def test_the_plan_shows_the_object_where_its_mirror_image_in_the_wall_is_that_of_the_prediction(pose):
    """Points before the wall are mirrored by hand; the plan of the image must show the points."""
    axes = ABOVE @ Rotation.from_euler("zxy", pose, degrees=True).as_matrix().T
    rays = pixel_rays(WIDTH, HEIGHT, FOV_DEG)
    normal, gap_m = PLANE / np.linalg.norm(PLANE), 1 / np.linalg.norm(PLANE)
    wall_m = 1 / (rays @ PLANE)
    depth_m = wall_m + 0.7  # behind the wall
    image = rays * depth_m[..., None]
    points = image - 2 * ((image @ normal) - gap_m)[..., None] * normal  # in camera axes
    world = points.reshape(-1, 3) @ axes
    ahead = axes[2, :2] / np.linalg.norm(axes[2, :2])
    expected = np.stack([world[:, 0] * ahead[1] - world[:, 1] * ahead[0], world[:, :2] @ ahead], axis=1)
    plan = Plan.of(seen(depth_m, np.ones((HEIGHT, WIDTH), bool)), Room(axes, PLANE), FOV_DEG)
    np.testing.assert_allclose(plan.points, expected, atol=1e-12)
    row = HEIGHT // 2
    edge = (rays * wall_m[..., None])[row, [0, -1]] @ axes
    np.testing.assert_allclose(np.linalg.norm(plan.sight, axis=1), np.hypot(*edge.T[:2]), atol=1e-12)
    if pose == (0, 0, 0):
        assert plan.sight[0, 0] < 0 < plan.sight[1, 0]  # left is left
        assert (plan.points[:, 1] < wall_m.max()).all()


def test_a_middle_wall_stands_in_the_plan_where_the_room_has_it():
    corners = np.array([[0.5, 1.0, -1], [1.5, 0.2, -1], [1.5, 0.2, 1], [0.5, 1.0, 1]])
    one = view(3.0).answer
    plan = Plan.of(one, Room(ABOVE, PLANE, corners), FOV_DEG)
    np.testing.assert_allclose(plan.middle_wall, corners[:, :2], atol=1e-15)
    assert plan.bounds[2] >= 1.5


def count(picture, colour):
    return int((np.asarray(picture) == colour).all(axis=-1).sum())


@pytest.mark.parametrize("middle_wall_m", [None, np.zeros((4, 3))], ids=["unknown", "known"])
def test_a_plan_without_a_middle_wall_says_that_it_is_not_known(middle_wall_m, monkeypatch):
    written, write = [], ImageDraw.ImageDraw.text

    def text(pen, place, words, *rest, **how):
        written.append(words)
        write(pen, place, words, *rest, **how)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", text)
    plan = Plan.of(view(3.0).answer, Room(ABOVE, PLANE, middle_wall_m), FOV_DEG)
    draw_prediction(replace(view(3.0), plan=plan), "words")
    is_known = middle_wall_m is not None
    assert ("middle wall" in written, "the middle wall is not known" in written) == (is_known, not is_known)


def test_with_one_scale_the_same_depth_has_the_same_colour_in_all_pictures():
    near, far = view(2.5), view(np.linspace(2.5, 4, WIDTH))
    scale = Scale.of([near, far])
    colour = scale.depth.of(np.array(2.5))
    pictures = [draw_prediction(each, "words", scale) for each in (near, far)]
    assert pictures[0].size == pictures[1].size
    pixel = (pictures[0].width // (4 * WIDTH)) ** 2  # an image pixel takes at least so many
    assert count(pictures[0], colour) > 15 * pixel  # 3 x 5 pixels of the object
    own = Scale.of([near]).depth.of(np.array(2.5))
    assert (own != colour).any()
    assert count(draw_prediction(near, "words"), own) > 15 * pixel


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (200, 2), (480, 640)], ids=str)
def test_images_of_any_shape_and_without_an_object_are_drawn(shape):
    shown = view(3.0, shape)
    nothing = replace(shown, answer=seen(np.zeros(shape), np.zeros(shape, bool)), light=np.zeros(shape))
    for each in (shown, nothing, replace(shown, knows_error=False)):
        assert min(draw_prediction(each, "").size) > 200


def test_a_name_with_letters_that_the_font_lacks_is_drawn():
    for name in ("測定 ק क.exr", "a\udcff.exr", "two\nlines.exr", 300 * "long"):
        picture = draw_prediction(replace(view(3.0), title=name), name)
        assert picture.size == draw_prediction(view(3.0), "").size
