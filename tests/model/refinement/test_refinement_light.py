"""What refinement finds in rendered measurements."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm

from disk.preset_files import read_settings
from itof import DepthMap, TransientLayout, pixel_rays
from itof.wall.wall_view import WallView
from model.data.corner import wall_view
from model.refinement.family import Family
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Comparison, corrected, least_misfits
from model.refinement.light.corner_light import CornerLight, known_corner, with_camera_at, with_wall_at
from model.refinement.refining import refined, without_edges
from model.refinement.unknowns import Fitted, moved, stretched
from model.refinement.wall_brightness import walls_as_bright
from scenegen import camera_axes, preset_from_dict, sample_valid_scene
from scenegen.geometry_check import refusal
from scenegen.pose import wall_geometry
from scenegen.scene import HiddenObject

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


def expected_wall(dataset):
    view = wall_view(dataset)
    return view.expected_wall(view.direct_phasors(WIDTH, HEIGHT, HZ), HZ)


@pytest.fixture(scope="module")
def light():
    return CornerLight(HZ)


@pytest.fixture
def comparison(seven, light):
    """Of a measurement of the seven scenes."""

    def compared(phasor):
        observed = HiddenLight.of(phasor, expected_wall(seven), fine=True)
        return Comparison(observed, known_corner(seven.scene(seven.ids()[0])), light, fine=True)

    return compared


def changed(candidate, change, *values):
    """A candidate whose one object is moved or stretched."""
    (part,) = candidate.hidden_objects
    return replace(candidate, hidden_objects=(change(part, *values),))


@pytest.fixture(scope="module")
def seven(make_dataset):
    return make_dataset(SEVEN)


@pytest.fixture(scope="module")
def lit(seven, variant):
    """Hidden and direct phasors of each scene."""
    return {scene_id: measured(seven, scene_id, variant) for scene_id in seven.ids()}


def test_a_wall_alone_leaves_nothing_to_compare(seven):
    wall = expected_wall(seven)
    off = replace(wall, plane_per_m=wall.plane_per_m * 1.01)
    light = HiddenLight.of(wall.direct * np.exp([0.003j, -0.004j, 0.005j]), off, fine=True)
    hidden = HiddenLight.of(
        wall.direct * (1 + 1e-3j * np.linspace(-1, 1, WIDTH)[:, None] ** 3), wall, fine=True
    )
    # a hundredth of the wall's distance is 1 cm; what it leaves is of second order
    assert norm(light.values) < 1e-2 * norm(hidden.values)


def test_a_wall_is_moved_onto_a_plane_in_any_corner():
    spread = {"location_m": 0.4, "rotation_deg": 8.0, "horizontal_fov_deg": 8.0}
    preset = preset_from_dict({"camera_spread": spread}, "a test")
    for index in range(12):
        scene = sample_valid_scene(preset, index, refusal)
        axes, wall = camera_axes(scene.camera), scene.relay_wall
        middle = axes @ (np.array(wall.location_m) - scene.camera.location_m)
        normal = axes @ wall_geometry(scene.camera, wall)["wall_normal"]
        plane = normal / (normal @ middle)
        same = with_wall_at(scene, plane).relay_wall
        np.testing.assert_allclose(same.location_m, wall.location_m, atol=1e-9)
        np.testing.assert_allclose(same.rotation_deg, wall.rotation_deg, atol=1e-6)
        plane = plane + 0.01 * norm(plane) * np.random.default_rng(index).normal(size=3)
        there = with_wall_at(scene, plane).relay_wall
        place = axes @ (np.array(there.location_m) - scene.camera.location_m)
        turned = axes @ wall_geometry(scene.camera, there)["wall_normal"]
        assert place @ plane == pytest.approx(1)
        assert norm(np.cross(turned, plane)) < 1e-9 * norm(plane)
        assert normal @ turned > 0.99


def test_in_any_corner_the_light_of_the_true_solids_is_the_measured_one(make_dataset, variant, light):
    """To 1 %; a pixel with a little of the middle wall, or a block with the end of a shadow, left more."""
    tables, _ = read_settings("presets", "judge-any-corner")
    corners = make_dataset(tables | {"dataset": {"count": 7, "seed": 4242}})
    for scene_id in corners.ids():
        true = corners.scene(scene_id)
        view = WallView(**wall_geometry(true.camera, true.relay_wall))
        wall = view.expected_wall(view.direct_phasors(WIDTH, HEIGHT, HZ), HZ)
        shown = without_edges(sum(measured(corners, scene_id, variant)), wall, true, light)
        found = Comparison(HiddenLight.of(shown, wall, fine=True), known_corner(true), light, fine=True)
        candidate = true
        for _ in range(2):
            found, candidate = found.behind(candidate)
        assert found.relative(found.misfits([candidate])[0]) < 0.01, scene_id


def test_few_nodes_with_what_they_lack_are_nearly_as_right_as_many(seven, lit, comparison):
    scene_id = seven.ids()[0]
    exact, true = comparison(sum(lit[scene_id])), seven.scene(scene_id)
    ((near, _),) = corrected([(exact, true)])
    np.testing.assert_allclose(near.misfits([true])[0], exact.misfits([true])[0], atol=1e-12)
    few, away = replace(near, lacking=None), changed(true, moved, np.full(3, 0.005))
    wrong = [norm(each.misfits([away])[0] - exact.misfits([away])[0]) for each in (near, few)]
    assert wrong[0] < wrong[1] / 2  # half a centimetre away


def test_the_wall_is_found_behind_the_solids(seven, lit, comparison):
    scene_id = seven.ids()[0]
    hidden, direct = lit[scene_id]
    before, true = comparison(hidden + direct), seven.scene(scene_id)
    after = before.behind(true)[0].behind(true)[0]
    plane = expected_wall(seven).plane_per_m
    off = [norm(each.observed.plane_per_m - plane) / norm(plane) for each in (before, after)]
    assert off[1] < off[0] / 4
    misfits = [each.relative(each.misfits([true])[0]) for each in (after, before)]
    assert misfits[0] < misfits[1]


def test_light_that_leaves_no_wall_moves_none(seven, lit, comparison):
    observed = comparison(sum(lit[seven.ids()[0]])).observed
    observed = replace(observed, slope=1e-3 * observed.slope)  # phases far below one turn
    depth_m = 1 / (observed.rays @ observed.plane_per_m)
    hidden = observed.relative * np.exp(-1j * depth_m[:, None] * observed.slope) - 1
    # The phases that remain are those of a wall that the first step puts at infinity.
    assert observed.with_wall_behind(hidden) is observed


@pytest.mark.parametrize(
    "index", [0, 2, 6, *(pytest.param(each, marks=pytest.mark.long) for each in (1, 4, 5))]
)
def test_a_solid_is_found_from_two_centimetres_and_ten_degrees_away(seven, lit, comparison, index):
    scene_id = seven.ids()[index]
    hidden, direct = lit[scene_id]
    true, rng = seven.scene(scene_id), np.random.default_rng(index)
    start = changed(true, moved, rng.normal(0, 0.012, 3), rng.normal(0, 0.1, 3))
    found = comparison(hidden + direct)
    candidate = replace(start, relay_wall=replace(start.relay_wall, roughness=0.7))
    (fit,) = least_misfits([(found, candidate)], steps=8, fitted=Fitted(roughness=True))
    for _ in range(2):
        (fit,) = least_misfits([found.behind(fit.candidate)], steps=6, fitted=Fitted(roughness=True))
        found = fit.comparison
    rays = pixel_rays(WIDTH, HEIGHT, 60.0).reshape(-1, 3)
    shown = [found.placed(each) for each in (true, start, fit.candidate)]  # in front of one wall
    depths_m = found.light.mirrored_depth_m(shown, rays)
    before_m, after_m = np.abs(depths_m[1:] - depths_m[0]).mean(axis=1)
    # One pixel at the edge of the object counts 0.25 cm. A sheet in its own shadow is known less well.
    assert after_m < (0.012 if true.object_class == "concave_plane" else 0.006)
    assert after_m < before_m
    assert fit.candidate.relay_wall.roughness == pytest.approx(true.relay_wall.roughness, abs=0.05)


def test_fits_side_by_side_end_where_each_ends_alone(seven, lit, comparison):
    found = comparison(sum(lit[seven.ids()[0]]))
    true, rng = seven.scene(seven.ids()[0]), np.random.default_rng(3)
    starts = [(found, changed(true, moved, rng.normal(0, 0.02, 3), rng.normal(0, 0.1, 3))) for _ in range(3)]
    together = least_misfits(starts, steps=3, fitted=Fitted(roughness=True))
    alone = [least_misfits([start], steps=3, fitted=Fitted(roughness=True))[0] for start in starts]
    assert [(fit.candidate, fit.misfit) for fit in together] == [(fit.candidate, fit.misfit) for fit in alone]
    before = found.misfits([start for _, start in starts])
    assert all(fit.misfit < found.relative(b) for fit, b in zip(together, before, strict=True))


def test_extents_are_found_too(seven, lit, comparison):
    index = next(i for i in range(7) if seven.scene(seven.ids()[i]).object_class == "cylinder")
    hidden, direct = lit[seven.ids()[index]]
    true = seven.scene(seven.ids()[index])
    start = changed(true, stretched, np.log([1.15, 0.9]))
    found = comparison(hidden + direct)
    (fit,) = least_misfits([(found, start)], steps=10, fitted=Fitted(sizes=True))
    (fit,) = least_misfits([found.behind(fit.candidate)], steps=6, fitted=Fitted(sizes=True))
    size_m = fit.candidate.hidden_objects[0].size_m
    # Coarse light is good to 3 %, and light goes at least with the size.
    np.testing.assert_allclose(size_m, true.hidden_objects[0].size_m, rtol=0.03)


def test_a_cube_stays_a_cube_when_it_is_stretched_and_a_box_does_not():
    def size_m(shape, size_m, exponents):
        return stretched(HiddenObject(shape, size_m, (0, 0, 0), (0, 0, 0), 1), np.log(exponents)).size_m

    assert size_m("cube", (0.5, 0.5, 0.5), [1.1]) == pytest.approx((0.55, 0.55, 0.55))
    assert size_m("parallelepiped", (0.3, 0.3, 0.6), [1.0, 2.0, 0.5]) == pytest.approx((0.3, 0.6, 0.3))
    assert size_m("cylinder", (0.4, 0.4, 0.55), [1.5, 1.0]) == pytest.approx((0.6, 0.6, 0.55))


def test_the_reflectance_is_found_too(seven, lit, light, comparison):
    """Of light that is the model's own; phases are in proportion to it but for one in a hundred."""
    true, (_, direct) = seven.scene(seven.ids()[0]), lit[seven.ids()[0]]
    rays = expected_wall(seven).rays.reshape(-1, 3)
    white = light.over_direct([true], rays, fine=True).reshape(direct.shape)
    found = replace(comparison(direct * (1 + 0.2 * white)), reflectance=None)
    for _ in range(3):
        found, true = found.behind(true)
    # The first of two rounds is off by 2 %, and the brightness of the wall by a tenth of that.
    assert found.reflectance_of(true) == pytest.approx(0.2, rel=4e-3)
    assert found.relative(found.misfits([true])[0]) < 4e-3


def test_the_noise_of_a_measurement_is_told_from_its_light(seven, lit, comparison):
    hidden, direct = lit[seven.ids()[1]]
    still, rng, shares = comparison(hidden + direct), np.random.default_rng(1), []
    # Without noise, edges of shadows are left: 0.3 % of the light.
    assert still.observed.noise_power < 1e-5 * norm(still.observed.values) ** 2
    for _ in range(8):
        white = rng.standard_normal((*direct.shape, 2)) @ np.array([1, 1j])
        noisy = comparison(hidden + direct + 1e-3 * np.abs(direct[..., :1]) * white)
        noise = noisy.observed.values - replace(still.observed, weight=noisy.observed.weight).values
        shares.append(noise @ noise / noisy.observed.noise_power)
    # 2100 values scatter by 3 % of their power, and `noise_power` has three times that; 8 make a third of it.
    assert 0.85 < np.mean(shares) < 1.05
    true = seven.scene(seven.ids()[1])
    found, true = noisy.behind(true)
    (misfit,) = found.misfits([true])
    assert found.relative(misfit) > 0.05
    assert found.unexplained(misfit) < found.relative(misfit) / 2


def test_an_empty_prediction_or_a_wall_that_nobody_sees_is_not_refined(seven, lit, light):
    hidden, direct = lit[seven.ids()[0]]
    known = (
        expected_wall(seven),
        known_corner(seven.scene(seven.ids()[0])),
        light,
        Family({"sphere": (0.56, 0.56, 0.56)}),
    )
    nothing = DepthMap.of_object(np.zeros((HEIGHT, WIDTH)), np.zeros((HEIGHT, WIDTH), bool), 20e6)
    assert refined(hidden + direct, nothing, 0.01, *known) is None
    dark = np.zeros_like(direct)
    dark[:4, :4] = direct[:4, :4]
    full = DepthMap.of_object(np.full((HEIGHT, WIDTH), 2.5), np.ones((HEIGHT, WIDTH), bool), 20e6)
    assert refined(dark, full, 0.01, *known) is None


def test_a_solid_in_noise_alone_is_not_accepted(seven, light):
    wall, scene = expected_wall(seven), seven.scene(seven.ids()[0])
    shown = np.zeros((HEIGHT, WIDTH), bool)
    shown[12:18, 20:26] = True
    prediction = DepthMap.of_object(np.where(shown, 2.6, 0.0), shown, 20e6)
    rng = np.random.default_rng(1)
    noise = 3e-3 * np.abs(wall.direct[..., :1]) * (rng.standard_normal((*wall.direct.shape, 2)) @ [1, 1j])
    family = Family({"sphere": (0.56, 0.56, 0.56), "cube": (0.5, 0.5, 0.5)}, reflectance=None)
    found = refined(wall.direct + noise, prediction, 1.0, wall, known_corner(scene), light, family)
    assert found.misfit == 0  # all is noise
    assert not found.is_right(1.0)
    assert not found.is_right(None)


@pytest.mark.parametrize("index", [3, pytest.param(9, marks=pytest.mark.long)])
def test_brightness_of_a_wall_is_read_from_its_amplitude(light, index):
    preset = preset_from_dict(
        {
            "camera_spread": {"location_m": 0.3, "rotation_deg": 5.0},
            "relay_wall": {"least_reflectance": 0.2},
            "dataset": {"seed": 5},
        },
        "a test",
    )
    scene = sample_valid_scene(preset, index, refusal)
    rays = pixel_rays(12, 9, 60.0).reshape(-1, 3)
    amplitude = 3e7 * light.direct([scene], rays)[0]
    (found,) = walls_as_bright([known_corner(scene)], rays, amplitude, light)
    true = scene.relay_wall.darkening
    # float32 rounds the amplitudes by 2^-24, of which the darkening changes a tenth or more.
    assert found.darkening.least_reflectance == pytest.approx(true.least_reflectance, abs=1e-5)
    assert found.darkening.direction_deg == pytest.approx(true.direction_deg, abs=1e-3)
    (even,) = walls_as_bright(
        [known_corner(scene)], rays, light.direct([known_corner(scene)], rays)[0], light
    )
    assert even.darkening is None or even.darkening.least_reflectance > 0.999


def test_a_corner_with_a_mesh_of_the_user_is_known_as_well_as_any_other(seven, light):
    scene = seven.scene(seven.ids()[0])
    with_mesh = replace(scene.hidden_objects[0], shape="mesh:letter.ply")
    rays = pixel_rays(12, 9, 60.0).reshape(-1, 3)
    known = [known_corner(each) for each in (scene, replace(scene, hidden_objects=(with_mesh,)))]
    direct, same = light.direct(known, rays)
    np.testing.assert_array_equal(direct, same)


def test_a_camera_is_moved_to_where_a_wall_has_a_plane():
    preset = preset_from_dict({"camera_spread": {"location_m": 0.4, "rotation_deg": 8.0}}, "a test")
    for index in range(12):
        scene = sample_valid_scene(preset, index, refusal)
        view = WallView(**wall_geometry(scene.camera, scene.relay_wall))
        plane = np.asarray(view.expected_wall(np.ones((3, 4, 1)), [20e6]).plane_per_m)
        same = with_camera_at(scene, plane).camera
        np.testing.assert_allclose(same.location_m, scene.camera.location_m, atol=1e-9)
        np.testing.assert_allclose(same.rotation_deg, scene.camera.rotation_deg, atol=1e-6)
        plane = plane + 0.05 * norm(plane) * np.random.default_rng(index).normal(size=3)
        there = with_camera_at(scene, plane)
        view = WallView(**wall_geometry(there.camera, there.relay_wall))
        assert view.expected_wall(np.ones((3, 4, 1)), [20e6]).plane_per_m == pytest.approx(plane)
        assert there.relay_wall == scene.relay_wall
