"""What is wrong with a measurement is found; valid measurements are not suspected."""

from dataclasses import replace

import numpy as np
import pytest
from wall_measurements import (
    DEFECTS,
    IMAGE_DEFECTS,
    expected_wall_of,
    farther,
    moved,
    noise,
    phasors_of,
    returned,
    wall_of_plane,
)

from itof.wall.plausibility import check_measurement, check_reference, describe_shift
from itof.wall.wall_fit import fit_wall
from itof.wall.wall_view import WallView
from scenegen import open_dataset
from scenegen.pose import wall_geometry

LEVEL = np.array([-0.6, 0.0, 0.7])  # 1/m: a wall whose rows may be mirrored


@pytest.fixture(scope="module")
def rendered(seven_renders):
    """The expected wall of seven rendered scenes, and the phasors of each."""
    dataset = open_dataset(seven_renders)
    return expected_wall_of(dataset), [phasors_of(dataset, scene_id) for scene_id in dataset.ids()]


@pytest.fixture(scope="module")
def closed_forms(closed_form_scenes):
    """The same of the twelve closed-form scenes."""
    ids = closed_form_scenes.ids()
    return expected_wall_of(closed_form_scenes), [phasors_of(closed_form_scenes, each) for each in ids]


def judged(z, wall, reference=None):
    """(code, refused) of the findings, and their sentences as one text."""
    findings = check_measurement(np.ascontiguousarray(z), wall, reference).findings
    return [(each.code, each.refused) for each in findings], "; ".join(each.sentence for each in findings)


@pytest.mark.parametrize("scenes", ["rendered", "closed_forms"])
def test_valid_measurements_are_not_suspected(scenes, request):
    wall, measurements = request.getfixturevalue(scenes)
    for seed, z in enumerate(measurements):
        grain = noise(z.shape, seed)
        other = (1e4 * z, z * (1 + 0.01 * grain), z + 0.01 * np.abs(z).mean() * grain)[seed % 3]
        assert judged(z, wall) == judged(other, wall) == ([], "")


@pytest.mark.parametrize("name", DEFECTS | IMAGE_DEFECTS)
def test_what_is_wrong_with_a_rendered_measurement_is_found(rendered, name):
    wall, measurements = rendered
    defects = DEFECTS | IMAGE_DEFECTS
    spoil, code, words = defects[name]
    z = measurements[list(defects).index(name) % len(measurements)]
    codes, text = judged(spoil(z, wall), wall)
    assert (code, True) in codes, text
    assert words in text


@pytest.mark.parametrize(("shift_m", "outcome"), [(0.0005, []), (0.003, [("wall-moved", False)])])
def test_a_wall_that_is_a_little_off_is_noted_from_where_it_can_be_told_from_hidden_light(
    rendered, shift_m, outcome
):
    wall, measurements = rendered
    for sign in (1, -1):
        assert judged(farther(measurements[0], wall, sign * shift_m), wall)[0] == outcome


def test_the_place_of_a_wall_that_moved_is_told(rendered):
    wall, measurements = rendered
    found = check_measurement(farther(measurements[0], wall, 0.05), wall)
    # Hidden light is worth less than half a millimetre (docs/science/design.md).
    assert found.wall.distance_shift_m == pytest.approx(0.05, abs=5e-4)
    assert found.wall.tilt_deg < 0.1
    assert describe_shift(found.wall).startswith("5.0 cm farther away")


def test_words_for_a_wall():
    wall = wall_of_plane()
    for distance_m, tilt_deg, words in (
        (0, 0, "where it should be"),
        (0.0021, 0, "2.1 mm farther away"),
        (-0.02, 1.5, "2.0 cm nearer and tilted by 1.5 degrees"),
        (0, 0.3, "tilted by 0.3 degrees"),
    ):
        fit = fit_wall(returned(wall, moved(wall.plane_per_m, distance_m, tilt_deg)), wall)
        assert describe_shift(fit) == words


def test_a_mirror_image_that_looks_the_same_is_not_told():
    # Rows of a level camera; columns of a camera that looks straight at the wall.
    level, straight = wall_of_plane(LEVEL), wall_of_plane(np.array([0.0, 0.0, 0.9]))
    for wall, mirrored in ((level, level.direct[::-1]), (straight, straight.direct[:, ::-1])):
        assert judged(mirrored, wall) == ([], "")
    assert (
        "mirrored left to right, or the image seems turned by half a turn"
        in judged(level.direct[:, ::-1], level)[1]
    )
    slanted = wall_of_plane()
    assert judged(slanted.direct[:, ::-1], slanted)[1] == "the image seems mirrored left to right"
    assert judged(slanted.direct[::-1], slanted)[1] == "the image seems mirrored top to bottom"
    assert judged(slanted.direct[::-1, ::-1], slanted)[1] == "the image seems turned by half a turn"


def test_a_square_image_may_be_transposed():
    wall = wall_of_plane(width=20, height=20)
    z = wall.direct
    for spoilt, words in (
        (z.swapaxes(0, 1), "rows and columns of the image seem exchanged"),
        (np.rot90(z, -1), "the image seems turned by a quarter turn to the right"),
        (np.rot90(z), "the image seems turned by a quarter turn to the left"),
        (np.rot90(z, 2).swapaxes(0, 1), "rows and columns of the image seem exchanged and reversed"),
    ):
        assert judged(spoilt, wall) == ([("convention", True)], words)


def test_two_defects_are_both_told():
    wall = wall_of_plane()
    both = "the image seems mirrored left to right and the phase falls with distance: conjugate?"
    assert judged(wall.direct[:, ::-1].conj(), wall)[1] == both


@pytest.mark.parametrize("frequency_hz", [20e6, 70e6])
def test_a_single_frequency_tells_less_and_nothing_wrong(frequency_hz):
    wall = wall_of_plane(LEVEL, (frequency_hz,))
    for name in ("noise", "ones", "one phase", "no amplitude", "conjugated", "negative", "columns"):
        spoil, code, words = DEFECTS[name]
        codes, text = judged(spoil(wall.direct, wall), wall)
        assert (code, True) in codes
        assert words in text
    far = judged(returned(wall, LEVEL / 2), wall)[1]  # twice the distance, or twice the frequency
    assert far.startswith(
        "the wall is not where the run has it, but 1.08 m farther away (or the camera's phase is off)"
        if frequency_hz == 20e6
        else "no wall found: the phases are not those of a flat wall within 2.14 m, the unambiguous range"
    )
    assert judged(wall.direct * (1 + 0.01 * noise(wall.direct.shape)), wall) == ([], "")


def test_damaged_and_saturated_pixels_are_noted(rendered):
    wall, measurements = rendered
    z = measurements[1].copy()
    z[4:6, 3:9] = 0
    assert judged(z, wall) == (
        [("dead-pixels", False)],
        "2.8 % of the pixels are dark amid lit ones: damaged pixels?",
    )
    z = measurements[1] * np.where(noise(z.shape[:2]).real > 1.5, np.exp(2j), 1)[..., None]
    assert judged(z, wall)[0] == [("strange-pixels", False)]
    strength = np.abs(measurements[1])
    z = measurements[1] * np.minimum(1, np.quantile(strength, 0.9) / strength)
    assert judged(z, wall)[0] == [("saturated", False)]
    assert judged(measurements[1] * (1 + 0.05 * noise(z.shape)), wall)[0] == [("scatter", False)]


def test_a_wall_that_ends_within_the_image_has_no_dead_pixels(rendered):
    wall, measurements = rendered
    z = measurements[2].copy()
    z[:, 15:] = 0
    z[:3] = 0
    assert judged(z, wall) == ([], "")


OFFSETS_RAD = np.array([0.7, -2.0, 1.1])


def test_a_measured_reference_may_show_another_wall_and_any_phases(rendered):
    wall, measurements = rendered
    turned = farther(np.exp(1j * OFFSETS_RAD), wall, 0.2)
    reference = 300 * wall.direct * turned
    assert check_reference(reference, wall) == ()
    assert judged(measurements[0] * turned, wall, reference) == ([], "")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d: d.conj(), "the reference: the phase falls with distance: conjugate?"),
        (lambda d: d[:, ::-1], "the reference: the image seems mirrored left to right"),
        (lambda d: d[..., [2, 1, 0]], "the reference: frequencies 20 and 60 MHz seem exchanged"),
        (lambda d: noise(d.shape), "the reference: the phases at 20, 50, 60 MHz are noise"),
        (lambda d: np.ones_like(d), "the reference: no wall found: the phase is the same in all pixels"),
    ],
)
def test_what_is_wrong_with_a_reference_is_found(rendered, spoil, words):
    findings = check_reference(spoil(rendered[0].direct * np.exp(1j * OFFSETS_RAD)), rendered[0])
    assert findings
    assert all(each.refused for each in findings)
    assert words in "; ".join(each.sentence for each in findings)


@pytest.mark.parametrize(
    ("spoil", "outcome", "words"),
    [
        (lambda z, w: z.conj(), [("convention", True)], "the phase falls with distance: conjugate?"),
        (lambda z, w: z[:, ::-1], [("convention", True)], "mirrored left to right"),
        (lambda z, w: -z, [("convention", True)], "opposite signs"),
        (lambda z, w: farther(z, w, 0.1), [("wall-moved", True)], "not where the reference has it, but"),
        (lambda z, w: farther(z, w, 0.003), [("wall-moved", False)], "capture the empty corner again"),
        (lambda z, w: z * np.exp(0.05j), [("phase-offsets", True)], "since the reference"),
        (lambda z, w: farther(z, w, 0.7), [("no-wall", True)], "do not show the same wall"),
    ],
)
def test_a_measurement_must_agree_with_its_reference(rendered, spoil, outcome, words):
    wall, measurements = rendered
    # Of the hidden light, a third of a millimetre is left in every comparison.
    codes, text = judged(spoil(measurements[0], wall), wall, wall.direct)
    assert codes == outcome, text
    assert words in text


def test_what_is_no_image_is_refused(rendered):
    wall, measurements = rendered
    for check in (check_measurement, check_reference):
        with pytest.raises(ValueError, match=r"expected phasors of shape \(18, 24, 3\), got \(17, 24, 3\)"):
            check(measurements[0][1:], wall)
        with pytest.raises(ValueError, match="NaN or infinite"):
            check(measurements[0] * np.nan, wall)


def test_a_camera_that_sees_no_wall_finds_none(rendered):
    wall = replace(rendered[0], direct=np.zeros_like(rendered[0].direct))
    assert judged(rendered[1][0], wall)[0] == [("no-wall", True)]


@pytest.mark.parametrize("count", [20, pytest.param(2000, marks=pytest.mark.thorough)])
def test_any_finite_numbers_are_judged(count):
    # Warnings are errors here: no overflow, no division by zero.
    shapes = ((8, 6, (20e6, 50e6, 60e6)), (1, 1, (20e6,)), (9, 9, (20e6,)), (16, 1, (1.0, 2e9)))
    walls = [wall_of_plane(width=width, height=height, frequencies_hz=f) for width, height, f in shapes]
    rng = np.random.default_rng(count)
    for index in range(count):
        wall = walls[index % len(walls)]
        z = wall.direct * 10.0 ** rng.integers(-300, 300)
        bits = z.view(np.uint64).reshape(-1)
        places = rng.integers(bits.size, size=rng.integers(bits.size))
        bits[places] ^= np.uint64(1) << rng.integers(64, size=places.size).astype(np.uint64)
        z[~np.isfinite(z)] = 0
        if index % 3 == 0:
            z.reshape(-1)[rng.integers(z.size, size=z.size // 2)] = 0
        for reference in (None, z, wall.direct):
            found = check_measurement(z, wall, reference)
            assert found.wall is None or np.isfinite(found.wall.misfit_rad).all()
        check_reference(z, wall)


def test_a_wall_within_those_of_the_training_is_no_half_of_the_frequencies(closed_form_scenes):
    """A camera 0.3 m nearer and turned by 4 degrees: its phases look halved to who expects the first."""
    scene = closed_form_scenes.scene(closed_form_scenes.ids()[0])
    moved_camera = replace(scene.camera, location_m=(0.71, -0.74, 1.51), rotation_deg=(90.0, -1.7, 53.6))
    expected, near = (
        WallView(**wall_geometry(camera, scene.relay_wall)).with_fov(60.0)
        for camera in (scene.camera, moved_camera)
    )
    hz = closed_form_scenes.preset.itof.frequencies_hz
    wall = expected.expected_wall(expected.direct_phasors(24, 18, hz), hz)
    z = near.direct_phasors(24, 18, hz)
    (lone,) = check_measurement(z, wall, self_calibrated=True).findings
    assert lone.refused
    assert "half those of the wall" in lone.sentence
    known = check_measurement(z, wall, self_calibrated=True, known_shift_m=0.5).findings
    assert [each.code for each in known] == ["no-hidden-light"]  # an empty wall


def test_the_edge_of_another_surface_is_no_seam():
    """A black surface from column 18 on, whose edge covers a part of the pixels beside it."""
    wall = wall_of_plane(width=40, height=30)
    z = wall.direct.copy()
    z[:, 18:] = 0
    part = np.linspace(0.6, 0.0, 30)[:, None]  # of a pixel; its mean path is off by half of this
    step = np.angle(z[:, 17] / z[:, 16])
    z[:, 17] *= (1 - part) * np.exp(-0.5j * part * step)
    assert not any("seam" in each.sentence for each in check_measurement(z, wall).findings)
    z[:, 9:] *= np.exp(0.02j)
    assert any("seam" in each.sentence for each in check_measurement(z, wall).findings)
