"""Many lights against a closed form, the path tracer, symmetries and its own claims about its error."""

import functools

import numpy as np
import pytest
import trimesh
from many_light_scenes import (
    BLACK,
    CAMERA_LOCATION_M,
    DOWN,
    FORWARD,
    FREQUENCIES_HZ,
    GAP_M,
    HORIZONTAL_FOV_DEG,
    LAYOUT,
    OBJECT_LOCATION_M,
    PROJECTOR_FOV_DEG,
    RIGHT,
    SMALL,
    Corner,
    ball,
    box,
    expose,
    measure,
    path_phasors,
    quad,
    relative,
    rough_plastic,
    square,
    two_sided,
)
from three_bounce_quadrature import hidden_phasors

from itof import MeasurementMatrix, pixel_rays
from render.transport.many_light import ManyLight
from render.transport.method import MethodOptions, View

AXES = np.stack([RIGHT, DOWN, FORWARD])
PATCH_NORMAL = (-1, 0.1, 0.2)
PLACE = {"location_m": {"x": [1.15, 1.15], "y": [0.9, 0.9], "z": [1.6, 1.6]}}
SEEDS = range(8)


def assert_agrees_with_paths(image, runs):
    """Sums within 5 sigma, and pixels scatter like the path tracer's own noise between `runs`."""
    hidden = runs - image.direct
    count = len(runs)
    total = image.hidden.sum(axis=(0, 1))
    sums = hidden.sum(axis=(1, 2)) / total  # (runs, F), 1 where both agree
    for part, expected in ((sums.real, 1), (sums.imag, 0)):
        sigma = part.std(axis=0, ddof=1) / np.sqrt(count)
        # Student's t with 11 degrees of freedom passes 5 once in 2500; six correlated looks.
        assert np.all(np.abs(part.mean(axis=0) - expected) < 5 * sigma + 1e-3)
    variance = (hidden.real.var(axis=0, ddof=1) + hidden.imag.var(axis=0, ddof=1)) / count  # (H, W, F)
    squared = np.abs(hidden.mean(axis=0) - image.hidden) ** 2
    # The sum of squares has the mean sum(v). Real and imaginary part may be one number, then each pixel
    # scatters by sqrt(2) v; estimating v from few runs adds 2 / (runs - 1) to the 2.
    scatter = np.sqrt((2 + 2 / (count - 1)) * (variance**2).sum(axis=(0, 1))) / variance.sum(axis=(0, 1))
    chi = squared.sum(axis=(0, 1)) / variance.sum(axis=(0, 1))
    # What every pixel shares, the lights' own error of at most 1 %, adds its square over the noise's.
    noise = np.sqrt(variance.sum(axis=(0, 1))) / np.linalg.norm(image.hidden, axis=(0, 1))
    assert np.all(np.abs(chi - 1) < 4 * scatter + (0.01 / noise) ** 2)


@pytest.fixture(scope="module")
def scenes(make_dataset, variant):
    """The four scenes of the proof, as night-gen writes them."""
    import mitsuba as mi

    def one(shapes, roughness, composite=0):
        hidden = {"shapes": shapes, "composite_fraction": composite, **PLACE}
        wall = {"roughness": [roughness]}
        camera = {"width": LAYOUT.width, "height": LAYOUT.height}
        dataset = make_dataset(
            {
                "dataset": {"count": 1, "seed": 3},
                "hidden_object": hidden,
                "relay_wall": wall,
                "camera": camera,
            }
        )
        return mi.load_file(str(dataset.scene_folder("000000") / "scene.xml"), optimize=False)

    return {
        "sphere": one(["sphere"], 0.3),
        "cube": one(["cube"], 0.6),
        "concave_plane": one(["concave_plane"], 0.9),
        "composite": one(["cone", "cylinder"], 0.6, 1),
    }


FOUR = ("sphere", "cube", "concave_plane", "composite")


@pytest.fixture(scope="module")
def unpiloted(variant):
    """Hidden phasors of a fixed number of lights, without the pilot that estimates their error."""

    def measured(scene, lights, seed):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(ManyLight, "_count_and_error", lambda *_: (lights, 0.0))
            return measure(scene, variant, lights=lights, seed=seed, layout=SMALL).hidden

    return measured


@pytest.fixture(scope="module")
def reference(scenes, unpiloted):
    """Hidden phasors of 4 x 8192 lights: by the rates below a ninth of the error of 1024 lights or less."""

    @functools.cache
    def average(name):
        return np.mean([unpiloted(scenes[name], 8192, seed) for seed in range(100, 104)], axis=0)

    return average


@pytest.fixture(scope="module")
def true_rms(scenes, reference, unpiloted):
    """(scene, lights) -> (F,) root mean square over seeds of the true error."""

    @functools.cache
    def rms(name, lights):
        errors = [relative(unpiloted(scenes[name], lights, seed), reference(name)) for seed in SEEDS]
        return np.sqrt(np.mean(np.square(errors), axis=0))

    return rms


# Closed form


@pytest.fixture(scope="module")
def patch_integral():
    patch = square(OBJECT_LOCATION_M, PATCH_NORMAL, 0.1)

    def integrate(order):
        return hidden_phasors(
            LAYOUT.width,
            LAYOUT.height,
            FREQUENCIES_HZ,
            patch.vertices,
            PATCH_NORMAL,
            camera=CAMERA_LOCATION_M,
            axes=AXES,
            camera_fov_deg=HORIZONTAL_FOV_DEG,
            projector_fov_deg=PROJECTOR_FOV_DEG,
            order=order,
        )

    np.testing.assert_allclose(integrate(20), integrate(40), rtol=1e-8)  # the quadrature has converged
    return patch, integrate(40)


@pytest.mark.parametrize("seed", range(4))
def test_a_small_patch_has_the_hidden_phasors_of_the_three_bounce_integral(
    patch_integral, variant, tmp_path, seed
):
    patch, expected = patch_integral
    scene = Corner((patch,), has_middle_wall=False).load(tmp_path)
    hidden = measure(scene, variant, lights=1024, seed=seed).hidden
    # The 0.5 %; measured errors of whole images are 0.1 %.
    np.testing.assert_allclose(hidden.sum(axis=(0, 1)), expected.sum(axis=(0, 1)), rtol=0.005)
    np.testing.assert_allclose(hidden, expected, rtol=0.005)


# The path tracer


@pytest.mark.parametrize("name", FOUR)
def test_many_lights_agree_with_the_path_tracer_within_its_noise(scenes, variant, name):
    image = measure(scenes[name], variant, lights=4096)
    # 12 x 2048 paths know the image sum to 0.4 % (1 % on the concave plane, which returns little).
    assert_agrees_with_paths(image, path_phasors(scenes[name], variant, seeds=range(12), spp=2048))


# Conservation and symmetry


def test_twice_the_emitter_gives_twice_the_signal(variant, tmp_path):
    corner = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    one, two = (measure(corner.but(emitter_scale=s).load(tmp_path), variant) for s in (1.0, 2.0))
    # A power of two changes no mantissa.
    for name in ("direct", "hidden", "total"):
        np.testing.assert_allclose(getattr(two, name), 2 * getattr(one, name), rtol=1e-12)
    assert two.error == pytest.approx(one.error, rel=1e-6)


def test_a_scene_mirrored_in_z_gives_the_image_upside_down(variant, tmp_path):
    mirror = trimesh.transformations.reflection_matrix(CAMERA_LOCATION_M, [0, 0, 1])
    solid = box((0.5, 0.3, 0.4), centre=(1.15, 0.9, 1.9))
    corner = Corner((solid,), wall_bsdf=rough_plastic(0.5))
    upright = measure(corner.load(tmp_path), variant, lights=4096)
    twin = corner.but(hidden=(solid.copy().apply_transform(mirror),))
    flipped = measure(twin.load(tmp_path), variant, lights=4096)
    assert relative(upright.hidden[::-1], upright.hidden).max() > 0.05  # the flip is no identity
    # Two measurements with independent points: sqrt(2) of the reported error is one sigma.
    allowed = 3 * np.hypot(upright.error, flipped.error)
    assert allowed < 0.03
    assert np.all(relative(flipped.hidden[::-1], upright.hidden) < allowed)
    np.testing.assert_allclose(flipped.direct[::-1], upright.direct, rtol=1e-5)  # float32 rays


@pytest.mark.parametrize(
    ("motion", "tolerance"),
    [
        # Distances of coordinates near 8 m in float32: 8 * 6e-8 m against 5 m paths and 1e-6 m mesh corners.
        (trimesh.transformations.translation_matrix([2, -4, 8]), 1e-3),
        # Turned, the surface is sampled in another order: three sigma of the error of 4096 points.
        (trimesh.transformations.euler_matrix(0.7, -0.4, 2.1), None),
    ],
    ids=["translation", "rotation"],
)
def test_moving_everything_together_changes_nothing(variant, tmp_path, motion, tolerance):
    corner = Corner((box(),), wall_bsdf=rough_plastic(0.5))
    still = measure(corner.load(tmp_path), variant, lights=4096)
    moved = measure(corner.but(moved=motion).load(tmp_path), variant, lights=4096)
    np.testing.assert_allclose(moved.direct, still.direct, rtol=1e-4)
    allowed = tolerance or 3 * np.hypot(moved.error, still.error)
    assert np.all(relative(moved.hidden, still.hidden) < allowed)


def test_without_a_hidden_object_the_hidden_signal_is_exactly_zero(variant, tmp_path):
    image = measure(Corner(wall_bsdf=rough_plastic(0.5)).load(tmp_path), variant)
    assert np.all(image.hidden == 0)
    assert image.error is None
    np.testing.assert_array_equal(image.total, image.direct)
    assert np.all(np.abs(image.direct) > 0)


def test_a_black_hidden_object_sends_no_hidden_signal(variant, tmp_path):
    image = measure(Corner((ball(),), hidden_bsdf=BLACK).load(tmp_path), variant)
    assert np.all(image.hidden == 0)
    np.testing.assert_array_equal(image.total, image.direct)


def test_half_the_reflectance_gives_half_the_hidden_signal(variant, tmp_path):
    corner = Corner((ball(),))
    full = measure(corner.load(tmp_path), variant)
    half = measure(corner.but(hidden_bsdf=two_sided("diffuse", reflectance=0.5)).load(tmp_path), variant)
    # The reflectance is read by evaluating the BSDF in float32.
    np.testing.assert_allclose(2 * half.hidden, full.hidden, rtol=1e-5)


@pytest.mark.parametrize("kind", ["spot", "point", "area"])
def test_other_emitters_than_a_projector_agree_with_the_path_tracer(variant, tmp_path, kind):
    import mitsuba as mi

    def facing_the_wall(height_m):
        origin = CAMERA_LOCATION_M + np.array([0, 0, height_m])
        return mi.ScalarTransform4f().look_at(origin.tolist(), (origin + FORWARD).tolist(), [0, 0, 1])

    lamp = facing_the_wall(0.3) @ mi.ScalarTransform4f().scale(0.05)
    emitter = {
        "spot": {"type": "spot", "to_world": facing_the_wall(0), "cutoff_angle": 25.0, "beam_width": 20.0},
        "point": {"type": "point", "position": CAMERA_LOCATION_M.tolist()},
        "area": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 50.0}},
    }[kind]
    scene = Corner((ball(),), other_emitter=emitter).load(tmp_path)
    image = measure(scene, variant, lights=2048)
    total = image.hidden.sum(axis=(0, 1))
    paths = path_phasors(scene, variant, seeds=range(10), spp=2048)
    # The direct part is the path tracer's own: a lamp with an extent is random in both.
    direct = path_phasors(scene, variant, seeds=range(1), spp=2048, max_bounces=1)[0]
    runs = (paths - direct).sum(axis=(1, 2)) / total
    sigma = runs.real.std(axis=0, ddof=1) / np.sqrt(len(runs))
    # Student's t with 9 degrees of freedom passes 5.5 once in 2500; the lights' own error is 0.5 %.
    assert np.all(np.abs(runs.real.mean(axis=0) - 1) < 5.5 * sigma + 0.005)
    assert np.all(sigma < 0.02)


def test_an_object_half_behind_a_black_blocker_gives_less_and_what_paths_say(variant, tmp_path):
    blocker = quad((0.75, 0.9, 1.0), (0.75, 1.6, 1.0), (0.75, 1.6, 2.2), (0.75, 0.9, 2.2))
    free = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    clear = measure(free.load(tmp_path), variant, lights=4096)
    scene = free.but(blockers=(blocker,)).load(tmp_path)
    shaded = measure(scene, variant, lights=4096)
    share = np.abs(shaded.hidden).sum() / np.abs(clear.hidden).sum()
    assert 0.2 < share < 0.9
    assert_agrees_with_paths(shaded, path_phasors(scene, variant, seeds=range(12), spp=1024))


def test_objects_shade_each_other(variant, tmp_path):
    near, far = ball(radius_m=0.15, centre=(0.7, 0.9, 1.6)), box(centre=(1.3, 1.0, 1.6))
    corner = Corner((near, far), wall_bsdf=rough_plastic(0.5))
    scene = corner.load(tmp_path)
    both = measure(scene, variant, lights=4096)
    alone = [measure(corner.but(hidden=(one,)).load(tmp_path), variant).hidden for one in (near, far)]
    assert np.abs(both.hidden).sum() < 0.97 * np.abs(sum(alone)).sum()
    assert_agrees_with_paths(both, path_phasors(scene, variant, seeds=range(12), spp=1024))


def test_the_middle_wall_shades_exactly_the_pixels_behind_it(variant, tmp_path):
    side_m = 0.05
    centre = np.array([1.3, 0.3, 1.65])
    corner = Corner((square(centre, (-1, 0.0, 0.0), side_m),))
    hidden = np.abs(measure(corner.load(tmp_path), variant).hidden[..., 0])
    open_hidden = np.abs(measure(corner.but(has_middle_wall=False).load(tmp_path), variant).hidden[..., 0])
    edges_y = []
    for side in (-0.5, 0.5):
        x, y = centre[0], centre[1] + side * side_m
        edges_y.append(-GAP_M * y / (x - GAP_M))  # the ray from (x, y) past the corner of the middle wall
    half_pixel = np.tan(np.radians(HORIZONTAL_FOV_DEG) / 2) / LAYOUT.width  # half a pixel, not a path length
    centres = pixel_rays(LAYOUT.width, LAYOUT.height, HORIZONTAL_FOV_DEG)
    centres = centres / centres[..., 2:]
    wall_y = []
    for side in (-1, 1):
        rays = (centres + np.array([side * half_pixel, 0, 0])) @ AXES
        wall_y.append(CAMERA_LOCATION_M[1] - CAMERA_LOCATION_M[0] * rays[..., 1] / rays[..., 0])
    shaded = np.maximum(*wall_y) < min(edges_y)
    lit = np.minimum(*wall_y) > max(edges_y)
    assert shaded.sum() > 50
    assert lit.sum() > 50
    assert np.all(open_hidden > 0)
    np.testing.assert_array_equal(hidden[shaded], 0)
    assert np.all(hidden[lit] > 0)
    assert np.all(hidden[lit] < open_hidden[lit])  # the wall also keeps light from the patch


# Convergence and the reported error


@pytest.mark.parametrize("name", ["sphere", "cube"])
def test_the_error_falls_faster_than_one_over_the_root_of_the_lights(true_rms, name):
    counts = [64, 128, 256, 512, 1024]
    rms = np.array([true_rms(name, count) for count in counts])  # (N, F)
    rates = -np.polyfit(np.log(counts), np.log(rms), 1)[0]
    # Sobol points on a surface with shadow edges: N^-3/4, up to N^-1 where the integrand is smooth. Eight
    # runs know an rms to 1/sqrt(16), and five doublings the exponent to 0.25 / (ln 2 sqrt(10)) = 0.11:
    # one over the root would be below 0.7 in 97 % of such fits.
    assert np.all(rates > 0.7)


@pytest.mark.parametrize("name", ["concave_plane", "composite"])
def test_the_error_of_64_lights_is_more_than_six_times_that_of_2048(true_rms, name):
    # 1/sqrt(N) is a factor of 5.7, N^-3/4 of 13; the two rms values of eight runs scatter by 35 %.
    assert np.all(true_rms(name, 64) / true_rms(name, 2048) > 6)


@pytest.mark.parametrize("lights", [256, 1024])
@pytest.mark.parametrize("name", FOUR)
def test_the_reported_error_is_the_true_error_within_a_factor_of_two(scenes, true_rms, variant, name, lights):
    reported = [measure(scenes[name], variant, lights=lights, seed=s, layout=SMALL).error for s in range(4)]
    ratio = np.sqrt(np.mean(np.square(reported))) / true_rms(name, lights)[-1]
    # Eight runs know an rms to 1/sqrt(16) = 25 %; four pilots of three degrees of freedom to 20 %.
    assert 0.5 / 1.3 < ratio < 2 * 1.3


def test_the_reported_error_of_a_patch_is_its_true_error_within_a_factor_of_two(
    patch_integral, variant, tmp_path
):
    patch, expected = patch_integral
    scene = Corner((patch,), has_middle_wall=False).load(tmp_path)
    images = [measure(scene, variant, lights=256, seed=s) for s in SEEDS]
    true = np.sqrt(np.mean([relative(image.hidden, expected)[-1] ** 2 for image in images]))
    reported = np.sqrt(np.mean([image.error**2 for image in images]))
    assert 0.5 / 1.3 < reported / true < 2 * 1.3


@pytest.mark.parametrize("name", FOUR)
def test_a_wanted_error_is_met_without_more_lights_than_it_needs(scenes, reference, true_rms, variant, name):
    wanted = 0.01
    exposure = ManyLight(MethodOptions(error=wanted), variant).expose(
        scenes[name], View(SMALL, FREQUENCIES_HZ, 3, 1)
    )
    image = exposure.phasors(FREQUENCIES_HZ)
    assert image.error <= wanted
    # One run lies within two of its sigmas, and the estimate within a factor of two.
    assert relative(image.hidden, reference(name))[-1] < 2 * 2 * wanted
    # What 1/sqrt(N) needs from 256 lights on, times the factor of two in the estimate (squared) and the
    # search's step of four. A light for each side of a surface.
    needed = 256 * max((true_rms(name, 256)[-1] / wanted) ** 2, 1)
    assert len(exposure.lights) <= 2 * 4 * 4 * needed


def test_any_number_of_lights_can_be_asked_for(scenes, reference, variant):
    # Not only powers of two; every warning is an error here.
    image = measure(scenes["cube"], variant, lights=300, layout=SMALL)
    assert relative(image.hidden, reference("cube"))[-1] < 3 * image.error


# Time-resolved


@pytest.mark.parametrize("name", FOUR)
def test_phi_of_the_transient_is_the_exact_phasor_within_one_percent_of_the_hidden_signal(
    scenes, variant, name
):
    exposure = expose(scenes[name], variant, lights=256)
    exact = exposure.phasors(FREQUENCIES_HZ)
    phi = MeasurementMatrix(FREQUENCIES_HZ, LAYOUT.bin_count, LAYOUT.bin_width_m, splat="tent")
    transient = np.concatenate(list(exposure.row_blocks()))
    assert transient.dtype == np.float32
    norm = np.linalg.norm(exact.hidden, axis=(0, 1))
    assert np.all(np.linalg.norm(phi.apply(transient) - exact.total, axis=(0, 1)) < 0.01 * norm)
    # At 1 Hz nothing turns: the phasor is the energy.
    steady = exposure.phasors((1.0,))
    energy = transient.sum(axis=-1, dtype=np.float64)
    difference = energy - np.abs(steady.total[..., 0])
    assert np.linalg.norm(difference) < 0.01 * np.linalg.norm(steady.hidden)
    assert abs(difference.sum()) < 0.01 * np.abs(steady.hidden).sum()


def test_the_hidden_part_of_a_transient_is_the_hidden_phasor(variant, tmp_path):
    # Without the bright direct return: what Φ sees of an object less what it sees without one.
    corner = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    phi = MeasurementMatrix(FREQUENCIES_HZ, LAYOUT.bin_count, LAYOUT.bin_width_m, splat="tent")
    full, empty = (expose(c.load(tmp_path), variant) for c in (corner, corner.but(hidden=())))
    binned = [phi.apply(np.concatenate(list(one.row_blocks()))) for one in (full, empty)]
    assert np.all(relative(binned[0] - binned[1], full.phasors(FREQUENCIES_HZ).hidden) < 0.005)
