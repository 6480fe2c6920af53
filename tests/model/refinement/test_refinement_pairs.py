"""Where the search for two solids begins, and what counts against them."""

from dataclasses import replace

import numpy as np
import pytest

from itof import DepthMap, TransientLayout, pixel_rays
from itof.metrics import image_metrics
from model.data.corner import wall_view
from model.prediction.explanation import Explanation, FoundSolid
from model.refinement.evidence import Prior
from model.refinement.family import Family, family_of
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Comparison, Fit, least_misfits
from model.refinement.light.corner_light import CornerLight, known_corner
from model.refinement.pairs import Pairs
from model.refinement.refining import refined
from model.refinement.search import _OF_PAIRS, Search
from model.refinement.sketch import Draws, Sketch
from model.refinement.unknowns import Fitted, moved
from scenegen import Preset, preset_from_dict
from scenegen.object_settings import ShapeSizes

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 40, 30

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def two(make_dataset):
    """One scene with two solids that intersect."""
    return make_dataset({"dataset": {"count": 1, "seed": 1}, "hidden_object": {"composite_fraction": 1.0}})


@pytest.fixture(scope="module")
def phasor(two, variant):
    """(H, W, F) of the scene."""
    from render.options import ManyLightOptions
    from render.transport.many_light import ManyLight
    from render.transport.method import View
    from render.transport.scene_loading import load_scene

    view = View(TransientLayout(WIDTH, HEIGHT, 2000, 0.01, 0.0), HZ, 3, 5)
    image = ManyLight(ManyLightOptions(lights=8192), variant).expose(load_scene(two, two.ids()[0]), view)
    return image.phasors().total


@pytest.fixture(scope="module")
def wall(two):
    view = wall_view(two)
    return view.expected_wall(view.direct_phasors(WIDTH, HEIGHT, HZ), HZ)


@pytest.fixture(scope="module")
def truth(two):
    return two.scene(two.ids()[0])


@pytest.fixture(scope="module")
def comparison(two, phasor, wall, truth):
    """With few nodes."""
    return Comparison(
        HiddenLight.of(phasor, wall, fine=False), known_corner(truth), CornerLight(HZ), fine=False
    )


def true_depth_map(comparison, truth):
    rays = pixel_rays(WIDTH, HEIGHT, truth.camera.horizontal_fov_deg).reshape(-1, 3)
    depth_m = comparison.light.mirrored_depth_m([truth], rays).reshape(HEIGHT, WIDTH)
    return DepthMap.of_object(depth_m, depth_m > 0, HZ[0])


@pytest.fixture(scope="module")
def sketch(comparison, truth):
    """The true depth map."""
    rays = pixel_rays(WIDTH, HEIGHT, truth.camera.horizontal_fov_deg)
    corner = comparison.placed(truth)
    return Sketch.of(
        comparison.light, corner, comparison.observed.plane_per_m, rays, true_depth_map(comparison, truth)
    )


@pytest.fixture(scope="module")
def libraries(sketch, truth):
    """Ten solids of three shapes in random rotations; the first of two are the true ones."""
    rng, shapes = np.random.default_rng(2), [part.shape for part in truth.hidden_objects]
    shapes.append(next(shape for shape in ("cube", "sphere", "cone") if shape not in shapes))
    found = []
    for shape in shapes:
        size_m = ShapeSizes().of(shape)
        draws = Draws.of(shape, size_m, sketch.inner_m, 10, rng, fits_sizes=False)
        found.append(draws.moved(rng.uniform(-0.05, 0.05, (10, 3))))
    for place, part in enumerate(truth.hidden_objects):
        true = Draws.of_solid(part)
        found[place].axes[0], found[place].centres_m[0] = true.axes[0], true.centres_m[0]
    return found


@pytest.fixture(scope="module")
def pairs(sketch, comparison, truth, libraries):
    walls = [replace(truth.relay_wall, roughness=each) for each in (0.1, truth.relay_wall.roughness)]
    return Pairs.of(sketch, comparison, libraries, 0.3, walls)


def solids(scene):
    """Shapes and places of the solids of a scene."""
    return {(part.shape, np.round(part.location_m, 6).tobytes()) for part in scene.hidden_objects}


def test_the_pair_that_has_depth_map_and_light_is_among_the_first(pairs, truth):
    starts = pairs.starts(4)
    # Of these two shapes, 4 of 100. The sum of both lights is an estimate: where one solid hides much of the
    # other, as with seeds 5 and 8, more wrong pairs come first.
    assert solids(truth) in [solids(start) for start in starts[:4]]
    shapes = {part.shape for start in starts for part in start.hidden_objects}
    assert shapes == set(pairs.libraries)
    assert len(starts) == 3 * 4


def test_pairs_of_likely_shapes_alone_are_begun_with(pairs, truth):
    likely = frozenset(part.shape for part in truth.hidden_objects)
    of_these = [start for start in pairs.starts(6) if {part.shape for part in start.hidden_objects} == likely]
    assert pairs.starts(6, [likely]) == of_these
    assert len(of_these) == 6


def test_no_pair_is_farther_apart_than_pairs_may_be(pairs):
    near = replace(pairs, apart_m=0.05)
    for start in near.starts(100):
        one, other = (np.array(part.location_m) for part in start.hidden_objects)
        assert np.abs(one - other).max() <= 0.05
    assert 0 < len(near.starts(100)) < len(pairs.starts(100))


def test_a_wrong_solid_is_exchanged_for_the_right_one(pairs, truth):
    right, wrong = truth.hidden_objects
    wrong = moved(wrong, np.array([0.05, -0.08, 0.06]), np.array([0.5, 0.5, 0.0]))
    found = pairs.exchanged([replace(truth, hidden_objects=(right, wrong))], 5)
    assert len(found) == 2 * 5
    assert solids(truth) in [solids(each) for each in found[:5]]  # with the right one kept
    assert all(each.relay_wall == truth.relay_wall for each in found)


def test_of_some_walls_the_one_that_explains_most_is_taken(pairs, truth):
    assert pairs.corner.relay_wall.roughness == truth.relay_wall.roughness


def test_one_sided_differences_lower_the_misfit_as_central_ones_do(comparison, truth):
    start = replace(truth, hidden_objects=tuple(moved(p, np.full(3, 0.02)) for p in truth.hidden_objects))
    (one,), (other,) = (
        least_misfits([(comparison, start)], steps=6, fitted=Fitted(), one_sided=each)
        for each in (True, False)
    )
    before = comparison.relative(comparison.misfits([start])[0])
    assert max(one.misfit, other.misfit) < before / 3


def test_a_second_solid_must_explain_more(comparison, sketch, truth):
    single = replace(truth, hidden_objects=truth.hidden_objects[:1])
    one, two = (Fit(comparison, each, 0.003, 0.003) for each in (single, truth))  # as good as the other
    apart_m = sketch.differences_m([single, truth])
    prior = Prior.of(sketch, 0.02)
    # Odds of one to six, six unknowns that lower a chi-squared by one each, and what the depth map says.
    expected = 2 * np.log(6) + 6 + (apart_m[1] ** 2 - apart_m[0] ** 2) / 0.02**2
    assert np.diff(prior.against([one, two]))[0] == pytest.approx(expected)


def test_a_preset_says_whether_two_solids_may_be_there():
    two, one = {"composite_fraction": 0.2, "composite_offset_m": [-0.2, 0.1]}, {"composite_fraction": 0.0}
    found = [family_of(preset_from_dict({"hidden_object": each}, "own"), ()) for each in (two, one)]
    assert [family.apart_m for family in found] == [0.2, None]


def test_two_solids_are_named():
    parts = tuple(FoundSolid(shape, *((0.5, 0.5, 0.5),) * 6) for shape in ("cube", "concave_plane"))
    accepted, refused = (Explanation(parts, ok, 0.003, 0.0, 0.0, 0.01, 1.0, None) for ok in (True, False))
    assert accepted.words == "a cube and a concave plane leave 0.3 % of the hidden light"
    assert "the best, a cube and a concave plane, leave 0.3 %" in refused.words


@pytest.mark.long
def test_two_solids_are_found_from_a_depth_map_that_is_off(comparison, phasor, wall, truth):
    # One of the scenes that are solved: of seeds 1, 3 and 4, the last two end at other shapes.
    true = true_depth_map(comparison, truth)
    rng = np.random.default_rng(3)
    off = true.radial_depth_m + true.mask * rng.normal(0.03, 0.02, true.mask.shape).astype(np.float32)
    prediction = DepthMap.of_object(off, true.mask, HZ[0])
    family = family_of(Preset(), ())
    found = refined(phasor, prediction, 0.02, wall, known_corner(truth), comparison.light, family)
    assert found.is_right(0.02)
    assert found.misfit < 0.003  # no derivation: below what is left of another pair (above), 0.3 %
    places_m = {part.shape: part.location_m for part in truth.hidden_objects}
    assert set(places_m) == {each.shape for each in found.solids}
    for each in found.solids:
        # No derivation: the depth map that it started from is 3 cm off.
        np.testing.assert_allclose(each.location_m, places_m[each.shape], atol=0.02)
    metrics = image_metrics(
        found.depth_map.radial_depth_m, found.depth_map.mask, true.radial_depth_m, true.mask
    )
    assert metrics.depth_mae_m < 0.006  # two pixels at edges


@pytest.mark.parametrize("fits_sizes", [False, True])
def test_a_round_without_starts_finds_nothing(fits_sizes):
    """As that of pairs where no two solids are near enough to each other."""
    family = Family({"cube": (0.5, 0.5, 0.5)}, fits_sizes)
    search = Search(None, None, None, Prior.of(None, None), family)  # nothing is compared
    assert search._funnelled([], _OF_PAIRS) == []


def test_two_solids_on_paths_of_their_own_are_as_far_apart_as_the_paths():
    one = {"shape": "cube", "path_m": [[1.0, 0.7, 1.6], [1.2, 0.9, 1.6]]}
    two = {"shape": "sphere", "path_m": [[1.1, 1.5, 1.8], [1.0, 1.2, 1.8]]}
    preset = {"dataset": {"frame_rate_hz": 5}, "object": [one | {"beside": [two]}]}
    assert family_of(preset_from_dict(preset, "a test"), ()).apart_m == pytest.approx(0.8)


def test_a_shape_that_is_listed_in_two_sizes_has_an_unknown_one():
    cubes = [{"shape": "cube", "size_m": size_m} for size_m in (0.3, 0.4)]
    assert family_of(preset_from_dict({"object": cubes}, "a test"), ()).fits_sizes
    assert not family_of(preset_from_dict({"object": cubes[:1]}, "a test"), ()).fits_sizes
