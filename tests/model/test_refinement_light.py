"""The closed three-bounce model against the renderer, and what it finds in rendered measurements."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm
from true_solids import solids_of

from itof import DepthMap, TransientLayout, pixel_rays
from model.data.corner import wall_view
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Comparison, Guess, fitted
from model.refinement.light.room import room_of
from model.refinement.light.solids import Solid
from model.refinement.light.three_bounces import Bounces
from model.refinement.refining import Family, Refined, refined

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 40, 30
SEVEN = {"dataset": {"count": 7, "seed": 3}}  # one of each shape, and a composite

pytestmark = pytest.mark.usefixtures("one_thread")


def measured(dataset, scene_id, variant, lights=8192):
    """Hidden and direct phasors (H, W, F) of a scene, with many lights."""
    from render.options import ManyLightOptions
    from render.transport.many_light import ManyLight
    from render.transport.method import View
    from render.transport.scene_loading import load_scene

    view = View(TransientLayout(WIDTH, HEIGHT, 2000, 0.01, 0.0), HZ, 3, 5)
    image = ManyLight(ManyLightOptions(lights=lights), variant).expose(load_scene(dataset, scene_id), view)
    found = image.phasors()
    return found.hidden, found.total - found.hidden


def comparison(dataset, phasor, *, fine=True, wall=None):
    view = wall_view(dataset)
    wall = view.expected_wall(view.direct_phasors(WIDTH, HEIGHT, HZ), HZ) if wall is None else wall
    observed = HiddenLight.of(phasor, wall, fine=fine)
    room = room_of(dataset).with_plane(observed.plane_per_m)
    return Comparison(observed, Bounces(room, observed.rays, WIDTH / HEIGHT, HZ, fine=fine))


@pytest.fixture(scope="module")
def seven(make_dataset):
    return make_dataset(SEVEN)


@pytest.fixture(scope="module")
def lit(seven, variant):
    """Hidden and direct phasors of each scene."""
    return {scene_id: measured(seven, scene_id, variant) for scene_id in seven.ids()}


@pytest.mark.parametrize("index", range(7))
def test_the_model_is_the_renderers_hidden_light(seven, lit, index):
    scene_id = seven.ids()[index]
    hidden, direct = lit[scene_id]
    expected = (hidden / direct).reshape(-1, 3)
    rays = pixel_rays(WIDTH, HEIGHT, 60.0).reshape(-1, 3)
    solids, roughness = solids_of(seven, scene_id), seven.scene(scene_id).relay_wall.roughness
    errors = []
    for fine in (True, False):
        found = Bounces(room_of(seven), rays, WIDTH / HEIGHT, HZ, fine=fine).over_direct(solids, roughness)
        errors.append(norm(found - expected) / norm(expected))
    # 8192 lights leave 0.3 %. The points of a union miss the edge where both solids meet.
    assert errors[0] < (0.07 if len(solids) > 1 else 0.01)
    assert errors[1] < (0.1 if len(solids) > 1 else 0.03)


def test_the_model_knows_diffuse_walls(make_dataset, variant):
    dataset = make_dataset(
        {
            "dataset": {"count": 1},
            "hidden_object": {"shapes": ["cylinder"], "composite_fraction": 0.0},
            "relay_wall": {"material": "diffuse", "reflectance": 0.6},
        }
    )
    hidden, direct = measured(dataset, "000000", variant)
    expected = (hidden / direct).reshape(-1, 3)
    rays = pixel_rays(WIDTH, HEIGHT, 60.0).reshape(-1, 3)
    found = Bounces(room_of(dataset), rays, WIDTH / HEIGHT, HZ, fine=True).over_direct(
        solids_of(dataset, "000000"), None
    )
    assert norm(found - expected) / norm(expected) < 0.008


def test_the_middle_wall_matters_and_is_in_the_model(make_dataset, variant):
    place = {"x": [1.3, 1.3], "y": [0.5, 0.5], "z": [1.6, 1.6]}  # as near to the middle wall as scenes get
    hidden = {"shapes": ["sphere"], "composite_fraction": 0.0, "location_m": place}
    dataset = make_dataset({"dataset": {"count": 1}, "hidden_object": hidden})
    light, direct = measured(dataset, "000000", variant)
    expected = (light / direct).reshape(-1, 3)
    rays, room = pixel_rays(WIDTH, HEIGHT, 60.0).reshape(-1, 3), room_of(dataset)
    errors = []
    for known in (room, replace(room, occluders=())):
        model = Bounces(known, rays, WIDTH / HEIGHT, HZ, fine=True)
        found = model.over_direct(solids_of(dataset, "000000"), dataset.scene("000000").relay_wall.roughness)
        errors.append(norm(found - expected) / norm(expected))
    assert errors[0] < 0.01  # half shadows are sums over points, too
    assert errors[1] > 0.03


def test_a_wall_alone_leaves_nothing_to_compare(seven):
    view = wall_view(seven)
    wall = view.expected_wall(view.direct_phasors(WIDTH, HEIGHT, HZ), HZ)
    moved = replace(wall, plane_per_m=wall.plane_per_m * 1.01)
    light = HiddenLight.of(wall.direct * np.exp([0.003j, -0.004j, 0.005j]), moved, fine=True)
    hidden = HiddenLight.of(
        wall.direct * (1 + 1e-3j * np.linspace(-1, 1, WIDTH)[:, None] ** 3), wall, fine=True
    )
    # a hundredth of the wall's distance is 1 cm; what it leaves is of second order
    assert norm(light.values) < 1e-2 * norm(hidden.values)


def test_the_wall_is_found_behind_the_solids(seven, lit):
    scene_id = seven.ids()[0]
    hidden, direct = lit[scene_id]
    before = comparison(seven, hidden + direct)
    guess = Guess(solids_of(seven, scene_id), seven.scene(scene_id).relay_wall.roughness)
    after = before.with_wall_behind(guess).with_wall_behind(guess)
    true = room_of(seven).plane_per_m
    off = [norm(each.observed.plane_per_m - true) / norm(true) for each in (before, after)]
    assert off[1] < off[0] / 4
    assert after.relative(after.misfit(guess)) < before.relative(before.misfit(guess))


@pytest.mark.parametrize(
    "index", [0, 2, 6, *(pytest.param(each, marks=pytest.mark.long) for each in (1, 4, 5))]
)
def test_a_solid_is_found_from_two_centimetres_and_ten_degrees_away(seven, lit, index):
    scene_id = seven.ids()[index]
    hidden, direct = lit[scene_id]
    (true,) = solids_of(seven, scene_id)
    rng = np.random.default_rng(index)
    start = true.moved(rng.normal(0, 0.012, 3), rng.normal(0, 0.1, 3))
    found = comparison(seven, hidden + direct)
    fit = fitted(found, Guess((start,), 0.7), steps=8, roughness=True)
    for _ in range(2):
        found = found.with_wall_behind(fit.guess)
        fit = fitted(found, fit.guess, steps=6, roughness=True)
    rays, room = pixel_rays(WIDTH, HEIGHT, 60.0), found.bounces.room
    depths_m = [room.mirrored_depth_m([each], rays) for each in (true, start, *fit.guess.solids)]
    before_m, after_m = (np.abs(each - depths_m[0]).mean() for each in depths_m[1:])
    # One pixel at the edge of the object counts 0.25 cm. A sheet in its own shadow is known less well.
    assert after_m < (0.012 if true.is_sheet else 0.006)
    assert after_m < before_m
    assert fit.guess.roughness == pytest.approx(seven.scene(scene_id).relay_wall.roughness, abs=0.05)


def test_extents_are_found_too(seven, lit):
    index = next(i for i in range(7) if seven.scene(seven.ids()[i]).object_class == "cylinder")
    scene_id = seven.ids()[index]
    hidden, direct = lit[scene_id]
    (true,) = solids_of(seven, scene_id)
    start = Guess((true.stretched(np.log([1.15, 0.9])),), seven.scene(scene_id).relay_wall.roughness)
    found = comparison(seven, hidden + direct)
    fit = fitted(found, start, steps=10, sizes=True)
    found = found.with_wall_behind(fit.guess)
    fit = fitted(found, fit.guess, steps=6, sizes=True)
    np.testing.assert_allclose(fit.guess.solids[0].size_m, true.size_m, rtol=0.03)


def test_the_reflectance_is_found_too(seven, lit):
    scene_id = seven.ids()[1]
    hidden, direct = lit[scene_id]
    guess = Guess(solids_of(seven, scene_id), seven.scene(scene_id).relay_wall.roughness)
    white = comparison(seven, 0.4 * hidden + direct)
    found = replace(white, reflectance=None).with_wall_behind(guess)
    assert found.reflectance_of(guess) == pytest.approx(0.4, rel=0.02)
    assert white.relative(white.misfit(guess)) > 1
    assert found.relative(found.misfit(guess)) < 0.02


def test_the_noise_of_a_measurement_is_told_from_its_light(seven, lit):
    scene_id = seven.ids()[1]
    hidden, direct = lit[scene_id]
    still, rng, shares = comparison(seven, hidden + direct), np.random.default_rng(1), []
    assert still.observed.noise_power < 1e-5 * norm(still.observed.values) ** 2
    for _ in range(8):
        white = rng.standard_normal((*direct.shape, 2)) @ np.array([1, 1j])
        noisy = comparison(seven, hidden + direct + 1e-3 * np.abs(direct[..., :1]) * white)
        noise = noisy.observed.values - replace(still.observed, weight=noisy.observed.weight).values
        shares.append(noise @ noise / noisy.observed.noise_power)
    # 2100 values scatter by 3 % of their power, and `noise_power` has three times that; 8 make a third of it.
    assert 0.85 < np.mean(shares) < 1.05
    guess = Guess(solids_of(seven, scene_id), seven.scene(scene_id).relay_wall.roughness)
    found = noisy.with_wall_behind(guess)
    misfit = found.misfit(guess)
    assert found.relative(misfit) > 0.05
    assert found.unexplained(misfit) < found.relative(misfit) / 2


def test_an_empty_prediction_or_a_wall_that_nobody_sees_is_not_refined(seven, lit):
    hidden, direct = lit[seven.ids()[0]]
    view = wall_view(seven)
    wall = view.expected_wall(view.direct_phasors(WIDTH, HEIGHT, HZ), HZ)
    family = Family({"sphere": (0.56, 0.56, 0.56)})
    nothing = DepthMap.of_object(np.zeros((HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH), bool), 20e6)
    assert refined(hidden + direct, nothing, wall, room_of(seven), family) is None
    dark = np.zeros_like(direct)
    dark[:4, :4] = direct[:4, :4]
    full = DepthMap.of_object(np.full((HEIGHT, WIDTH), 2.5), np.ones((HEIGHT, WIDTH), bool), 20e6)
    assert refined(dark, full, wall, room_of(seven), family) is None


def test_with_noise_a_solid_must_also_be_where_the_network_sees_it():
    shown = np.zeros((4, 5), bool)
    shown[1, :2] = True
    prediction = DepthMap.of_object(np.where(shown, 2.0, 0.0), shown, 20e6)
    solid = Solid("sphere", (0.56, 0.56, 0.56), np.zeros(3), np.eye(3))

    def found(misfit, noise, by_m):
        depth_map = DepthMap.of_object(np.where(shown, 2.0 + by_m, 0.0), shown, 20e6)
        return Refined(solid, 1.0, 0.5, misfit, noise, depth_map)

    assert found(0.0, 0.0, 0.3).difference_m(prediction) == pytest.approx(0.03)  # two of twenty pixels
    for misfit, noise, by_m, expected_m, right in (
        (0.011, 0.0, 0.0, 0.01, False),  # it does not explain the light
        (0.009, 0.009, 0.9, 0.01, True),  # little noise: the light decides
        (0.0, 0.02, 0.3, 0.01, False),  # noise: three times the expected error away
        (0.0, 0.02, 0.19, 0.01, True),
        (0.0, 0.02, 0.9, None, True),  # a network that expects no error
    ):
        assert found(misfit, noise, by_m).is_right(prediction, expected_m) == right
    assert found(0.0, 0.02, 0.3).is_right(prediction, 0.01, largest_difference=3.1)
    assert not found(0.0, 0.008, 0.3).is_right(prediction, 0.01, largest_misfit=0.006)
    for by_m, right in ((0.19, True), (0.21, False)):  # more may stay unexplained: the same rule
        assert found(0.05, 0.0, by_m).is_right(prediction, 0.01, largest_misfit=0.1) == right
    assert found(0.011, 0.0, 0.0).is_right(prediction, 0.01, largest_misfit=0.02)
