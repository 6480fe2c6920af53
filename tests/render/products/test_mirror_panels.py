"""The mirror trick in pictures: a mirror in the place of the wall shows what the reflected object shows."""

from dataclasses import replace

import numpy as np
import pytest
from night_commands import night_here, refusal
from PIL import Image
from scipy.ndimage import maximum_filter, minimum_filter
from test_mirror_occluders import HEIGHT, WIDTH, preset_of, truth_of

from render import mirror_panels
from render.mirror_panels import _along_the_wall, render_mirror_panels
from render.products.panels_figure import grey_values
from render.settings import RenderError
from scenegen import camera_axes, preset_from_dict, sample_scene, wall_normal

PATHS = 64


@pytest.fixture(scope="module")
def in_full_view(make_dataset):
    """A cube whose mirror image nothing hides."""
    return make_dataset(preset_of(1.0, 1.3))


@pytest.fixture(scope="module")
def partly_hidden(make_dataset):
    """A cube whose image the mirrored middle wall hides in part: as in the paper, and as in a real mirror."""
    return [make_dataset(preset_of(1.3, 0.5, mirror_occluders=option)) for option in (False, True)]


def panels_of(dataset):
    return render_mirror_panels(dataset, "000000", device="cpu", paths=PATHS, width=WIDTH)


def near_an_edge(mask):
    """Pixels with another kind of pixel around them: an edge can cross them."""
    return maximum_filter(mask, 3) != minimum_filter(mask, 3)


def assert_same_pixels(picture, other, mask):
    """Both pictures show light in all pixels of `mask` and nowhere else, except where its edges are."""
    edge = near_an_edge(mask)
    for one in (picture, other):
        np.testing.assert_array_equal((one > 0)[~edge], mask[~edge])
    differing = (picture > 0) != (other > 0)
    # A pixel of which the object covers the share q stays black if all paths miss it: (1 - q)^n with n paths
    # that find light. Over all q this is 1 / (n + 1). A tenth of the edge pixels means n = 20, of 64 paths.
    assert differing.sum() <= edge.sum() / 10
    both, either = (picture > 0) & (other > 0), (picture > 0) | (other > 0)
    assert both.sum() / either.sum() >= 1 - edge.sum() / 10 / either.sum()


def test_a_perfect_mirror_and_the_reflected_object_show_the_same_pixels(in_full_view, variant):
    found = panels_of(in_full_view)
    assert found.mirror.shape == found.trick.shape == (HEIGHT, WIDTH)
    mask = truth_of(in_full_view).mask
    assert mask.sum() > 50
    assert_same_pixels(found.mirror, found.trick, mask)
    assert found.corner.min() > 0  # the wall is lit everywhere


def test_the_mirrored_middle_wall_explains_what_a_mirror_does_not_show(partly_hidden, variant):
    paper, mirror = partly_hidden
    whole, visible = truth_of(paper).mask, truth_of(mirror).mask
    as_in_paper, as_in_mirror = panels_of(paper), panels_of(mirror)
    assert_same_pixels(as_in_mirror.mirror, as_in_mirror.trick, visible)
    edge = near_an_edge(whole) | near_an_edge(visible)
    hidden = (as_in_paper.trick > 0) & (as_in_paper.mirror == 0)
    np.testing.assert_array_equal(hidden[~edge], (whole & ~visible)[~edge])
    assert (whole & ~visible)[~edge].sum() > 10
    np.testing.assert_array_equal(
        as_in_paper.mirror, as_in_mirror.mirror
    )  # the option changes no real mirror


def test_the_light_comes_from_behind_the_camera(variant):
    import mitsuba as mi

    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for ahead in np.eye(3), -np.eye(3), np.array([[0.6, 0.0, 0.8], [0.48, -0.6, 0.64]]):
        for one in ahead:
            sky = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(mirror_panels._half_sky(one))})
            columns = [mi.Float(np.ascontiguousarray(column, np.float32)) for column in directions.T]
            # An emitter gets the direction back to the point that it lights.
            si = mi.SurfaceInteraction3f()
            si.wi = -mi.Vector3f(*columns)
            radiance = np.array(sky.eval(si))[0]
            along = directions @ one
            # Interpolation between pixels of 0.7 degrees blurs the edge by so much: sin(1 degree) = 0.017.
            clear = np.abs(along) > 0.02
            np.testing.assert_allclose(radiance[clear], along[clear] < 0, atol=1e-6)


def test_grey_values_are_brighter_where_the_radiance_is():
    radiance = np.array([[0.0, 0.1, 0.2], [0.4, 0.8, 0.8]])
    grey = grey_values(radiance)
    assert np.all(np.diff(grey.ravel()) >= 0)
    assert (grey[0, 0], grey[1, 2]) == (0, 1)
    assert grey[1, 0] == pytest.approx(0.5 ** (1 / 2.2))
    assert not grey_values(np.zeros((2, 3))).any()


def test_the_command_draws_three_pictures(in_full_view, tmp_path, variant):
    options = ("--width", WIDTH, "--device", "cpu")
    done = night_here("night-render", "panels", in_full_view.root, "000000", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "the mirror trick with scene 000000: 000000_panels.png\n"
    with Image.open(tmp_path / "000000_panels.png") as picture:
        assert picture.format == "PNG"
        pixels = np.asarray(picture.convert("L")).astype(float)
    third = pixels.shape[1] // 3
    _, mirror, trick = (pixels[40:-8, start + 12 : start + third - 12] for start in (0, third, 2 * third))
    # The black of both pictures is in the same places.
    assert np.mean((mirror < 20) != (trick < 20)) < 0.05
    assert 0.005 < np.mean(trick > 100) < 0.5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("000009",), "no scene 000009"),
        (("000000", "--out", "x.pdf"), "the panels are a .png file: cannot write x.pdf"),
        ((), "Missing argument 'ID'"),
    ],
)
def test_panels_that_cannot_be_drawn_are_refused(in_full_view, tmp_path, arguments, words):
    assert words in refusal("night-render", "panels", in_full_view.root, *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_pictures_that_would_be_too_high_are_refused(make_dataset, tmp_path):
    data = preset_of(1.0, 1.3)
    data["camera"] |= {"width": 4, "height": 40, "horizontal_fov_deg": 5.0}
    sentence = refusal("night-render", "panels", make_dataset(data).root, "000000", cwd=tmp_path)
    assert "pictures of 320 x 3200 pixels cannot be drawn: the camera has 4 x 40" in sentence
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("turn_deg", [90.0, 65.0])  # with 65 degrees, some pixels see the light
def test_a_camera_that_looks_straight_at_the_wall_is_refused(make_dataset, tmp_path, turn_deg):
    data = preset_of(1.3, 0.9)
    data["camera"] |= {"location_m": [1.0, -1.0, 1.65], "rotation_deg": [90.0, 0.0, turn_deg]}
    dataset = make_dataset(data)
    sentence = refusal("night-render", "panels", dataset.root, "000000", "--device", "cpu", cwd=tmp_path)
    assert "the camera looks straight at the relay wall" in sentence
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wall_deg", range(-80, 81, 10))
def test_rounding_is_no_direction_along_the_wall(wall_deg):
    scene = sample_scene(preset_from_dict(preset_of(1.3, 0.9), "test"), 0)
    straight = replace(
        scene,
        relay_wall=replace(scene.relay_wall, rotation_deg=(0.0, 90.0, wall_deg + 0.75)),
        camera=replace(scene.camera, rotation_deg=(90.0, 0.0, 90.75 + wall_deg)),
    )
    towards = camera_axes(straight.camera)[2] @ wall_normal(straight.relay_wall)
    assert abs(towards) == pytest.approx(1, abs=1e-12)
    with pytest.raises(RenderError, match="looks straight at the relay wall"):
        _along_the_wall(straight, (320, 240))
