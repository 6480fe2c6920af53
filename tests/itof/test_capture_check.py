"""What is wrong with a capture is said in words, without a network."""

import json

import numpy as np
import pytest
from captures import raw_of, sidecar_of, steps, taps_of, write_sidecar
from kill_points import killed_before
from measurements import write_npz
from night_commands import night_here, refusal
from wall_measurements import (
    FOV_DEG,
    FREQUENCIES_HZ,
    SLANTED,
    exchanged,
    moved,
    noise,
    wall_of_plane,
)

from itof.capture.capture import ImageShape, capture_of
from itof.capture.checking import check_capture
from itof.capture.facts import milliradians
from itof.capture.image_check import check_image
from itof.capture.importing import import_capture
from itof.capture.record import imported_fov_deg, record_path
from itof.capture.sidecar import CaptureError
from itof.sensor.cameras import load_sensor
from itof.sensor.demodulation import folded
from itof.wall.expected_wall import ExpectedWall
from itof.wall.unknown_wall import see_wall

WALL = wall_of_plane()
PHASOR = WALL.direct * (1 + 2e-4 * noise(WALL.direct.shape))
OFFSETS = np.exp(1j * np.array([0.5, 1.4, -2.0]))


def codes(phasor):
    return [each.code for each in check_image(phasor, FREQUENCIES_HZ, FOV_DEG).findings]


def sentence(phasor):
    found = check_image(phasor, FREQUENCIES_HZ, FOV_DEG).findings
    assert len(found) == 1, found
    return found[0].sentence, found[0].refused


@pytest.mark.parametrize(
    ("plane", "offsets"),
    [(SLANTED, OFFSETS), (np.array([0.1, 0.05, 0.6]), 1.0), (np.array([-0.8, 0.0, 0.5]), OFFSETS)],
)
def test_a_wall_is_found_from_nothing_with_any_phase_offsets(plane, offsets):
    wall = wall_of_plane(plane)
    fit, defects = see_wall(wall.direct * offsets, FREQUENCIES_HZ, FOV_DEG)
    assert defects == ()
    # Twice the standard deviations that the fit states.
    assert (np.abs(fit.plane_per_m - plane) < 2 * np.sqrt(np.diag(fit.plane_covariance))).all()
    assert (np.abs(np.angle(np.exp(-1j * fit.offsets_rad) * offsets)) < 2 * fit.offsets_std_rad).all()
    assert codes(wall.direct * offsets) == []


DEFECTS = {
    "the frequencies seem to be in another order: 20, 50, 60 MHz look like 50, 60, 20 MHz": lambda z: z[
        ..., [1, 2, 0]
    ],
    "the phase falls with distance: conjugate? and frequencies 50 and 60 MHz seem exchanged": lambda z: (
        exchanged(z.conj(), 1, 2)
    ),
    "the image seems stored column by column": lambda z: z.swapaxes(0, 1).reshape(z.shape),
}


@pytest.mark.parametrize("words", DEFECTS)
def test_a_wrong_sign_and_order_are_told_apart_with_any_phase_offsets(words):
    assert sentence(DEFECTS[words](PHASOR * OFFSETS)) == (words, True)


def test_what_shows_no_wall_is_refused():
    assert codes(noise(PHASOR.shape)) == ["no-wall"]
    assert codes(0 * PHASOR) == ["no-wall"]
    assert codes(PHASOR / np.abs(PHASOR)) == ["even-amplitude"]
    assert codes(np.abs(PHASOR) * np.exp(0.3j)) == ["no-wall"]
    assert codes(np.where(np.arange(26)[:, None] < 8, PHASOR, 0)) == ["dark"]


def test_a_wall_out_of_range_is_told_with_its_distance():
    far = wall_of_plane(np.array([0.01, 0.0, 0.12])).direct
    words, refused = sentence(far)
    assert "m away, out of the range of 0.2 to 6 m" in words
    assert not refused
    near = wall_of_plane(SLANTED * 20).direct  # a depth in the wrong unit, or frequencies too low
    assert codes(near) == ["wall-range"]


def test_a_wall_that_is_not_flat_is_told_from_errors_of_the_camera():
    column = np.linspace(-1, 1, PHASOR.shape[1])[None, :, None]
    bump_m = 0.015 * np.cos(np.pi * column)
    found = check_image(PHASOR * np.exp(1j * WALL.slope * bump_m), FREQUENCIES_HZ, FOV_DEG).findings
    assert found[0].code == "not-flat"
    assert found[0].sentence.startswith("the wall is not flat: it leaves its plane by")
    assert not found[0].refused
    wiggling = 0.05 * np.sin(4 * np.angle(PHASOR))
    found = check_image(PHASOR * np.exp(1j * wiggling), FREQUENCIES_HZ, FOV_DEG).findings
    assert found[0].code == "phase-errors"
    assert "wiggling" in found[0].sentence


@pytest.mark.parametrize(
    ("camera", "plane"),
    [
        ("opt8241", SLANTED),
        ("mlx75027", np.array([0.1, -0.06, 1.2])),
        ("opt8241", np.array([0.05, 0.0, 0.67])),
    ],
)
def test_the_waves_of_an_uncalibrated_camera_are_told_and_not_refused(camera, plane):
    wall = ExpectedWall.of_plane(plane, 40, 30, FREQUENCIES_HZ, FOV_DEG)
    z = [folded(load_sensor(camera), wall.direct[..., n], f) for n, f in enumerate(FREQUENCIES_HZ)]
    found = check_image(np.stack(z, axis=-1), FREQUENCIES_HZ, FOV_DEG).findings
    assert {each.code for each in found} & {"phase-errors", "not-flat"}
    assert not any(each.refused for each in found)


@pytest.mark.parametrize(("times", "refused"), [(1.1, True), (0.9, False)])
def test_50_mrad_that_are_no_waves_are_refused(times, refused):
    column = np.linspace(-1, 1, PHASOR.shape[1])[None, :, None]
    fit = check_image(PHASOR * np.exp(0.02j * np.sin(6 * column)), FREQUENCIES_HZ, FOV_DEG).fit
    scale = times * 0.02 * 0.05 / np.sqrt((fit.weight[..., None] * fit.rest_rad**2).sum(axis=(0, 1))).max()
    found = check_image(PHASOR * np.exp(1j * scale * np.sin(6 * column)), FREQUENCIES_HZ, FOV_DEG).findings
    assert [each.refused for each in found if each.code == "phase-errors"] == [refused]


def capture(
    tmp_path, count=6, sigma=1e-3, drift_rad=0.0, saturated=0.0, dead=0.0, dark=0.0, phasor=WALL.direct
):
    rng = np.random.default_rng(1)
    grow = np.exp(1j * drift_rad * np.linspace(0, 1, count))
    raw = np.stack([taps_of(phasor * turn, steps(4), steps(2)) for turn in grow])
    raw += sigma * np.abs(phasor)[..., None, None] * rng.standard_normal(raw.shape)
    raw += dark * np.abs(phasor)[..., None, None] * rng.standard_normal(raw.shape[1:])  # of the dark frame
    raw[0][rng.random(raw.shape[1:3]) < saturated] = 50
    raw[:, rng.random(raw.shape[1:3]) < dead] = 0.1
    return raw, {"saturation_dn": 40.0}


@pytest.mark.parametrize(
    ("given", "code", "words"),
    [
        ({"sigma": 1e-2}, "noise", "mrad, measured from the scatter of the frames"),
        (
            {"drift_rad": 0.02},
            "drift",
            "the phases drift by 20, 20, 20 mrad at 20, 50, 60 MHz within 6 frames",
        ),
        ({"saturated": 0.1}, "saturated", "% of the sensor pixels are saturated"),
        ({"dark": 3e-3}, "dark-noise", "mrad: few dark frames, whose noise is the same in all frames"),
    ],
)
def test_what_the_frames_say_is_told(tmp_path, given, code, words):
    raw, changes = capture(tmp_path, **given)
    sidecar = sidecar_of(tmp_path, **changes)
    found = capture_of(raw_of(sidecar, raw=raw), sidecar)
    told = check_image(found.phasor, FREQUENCIES_HZ, FOV_DEG, found.facts).findings
    assert code in [each.code for each in told]
    (mine,) = [each for each in told if each.code == code]
    assert ("dark-noise" in [each.code for each in told]) == ("dark" in given)
    assert words in mine.sentence
    assert not mine.refused


def test_dead_pixels_of_the_sensor_are_told_where_the_image_has_none(tmp_path):
    raw, changes = capture(tmp_path, dead=0.1)
    sidecar = sidecar_of(tmp_path, **changes)
    found = capture_of(raw_of(sidecar, raw=raw), sidecar, ImageShape(bin_side=2))
    assert (found.phasor != 0).all()
    findings = check_image(found.phasor, FREQUENCIES_HZ, FOV_DEG, found.facts).findings
    (told,) = [each for each in findings if each.code == "dead-pixels"]
    assert told.sentence.startswith(f"{100 * found.facts.dead:.2g} % of the sensor pixels are dead")
    assert not told.refused


def test_noise_is_that_of_neighbours_where_no_frames_tell_it():
    noisy = WALL.direct * (1 + 5e-3 * noise(WALL.direct.shape))
    found = check_image(noisy, FREQUENCIES_HZ, FOV_DEG)
    assert [each.code for each in found.findings] == ["noise"]
    # Told by the 468 pixels of an image, it scatters by 7 % over 12 seeds; twice that.
    np.testing.assert_allclose(found.noise_rad, 5e-3, rtol=0.15)
    assert "scatter" in codes(WALL.direct * (1 + 0.12 * noise(WALL.direct.shape)))


def test_phases_are_told_with_two_digits_each():
    assert milliradians((1.1e-3, 1.06e-3, 1e-3)) == "1.1, 1.1, 1.0 mrad"
    assert milliradians((-3.21e-4, 0.0996, 1.4023)) == "-0.32, 100, 1402 mrad"
    assert milliradians((0.0, 1e-16, 9.96e-3)) == "0, 0, 10 mrad"


# Commands


@pytest.fixture
def frames(tmp_path):
    raw, changes = capture(tmp_path, sigma=1e-3)
    np.savez(tmp_path / "frames.npz", raw=raw)
    np.savez(tmp_path / "empty.npz", raw=capture(tmp_path, count=3)[0])
    write_sidecar(tmp_path / "sidecar.toml", **changes)
    return tmp_path


def test_raw_frames_become_a_measurement_that_is_checked(frames):
    words = ("--sidecar", frames / "sidecar.toml")
    done = night_here(
        *("night-eval", "capture", "import", frames / "frames.npz", *words, "--empty", frames / "empty.npz"),
        *("--bin", 2, "--out", frames / "corner.npz", "--json"),
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["facts"]["frames"] == 6
    assert told["facts"]["image_size"] == [13, 9]
    assert "the reference adds" in done.stderr
    done = night_here(
        "night-eval", "capture", "check", frames / "corner.npz", "--out", frames / "picture.png"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("fine: nothing is wrong\nthe wall is 1.")
    assert "the reference: 3 frames of 13x9 pixels" in done.stdout
    assert (frames / "picture.png").read_bytes().startswith(b"\x89PNG")
    # only an earlier import is replaced, also one that was killed after it had written its record
    again = ("night-eval", "capture", "import", frames / "frames.npz", *words, "--out")
    assert night_here(*again, frames / "corner.npz").returncode == 0
    (frames / "corner.npz").unlink()
    assert night_here(*again, frames / "corner.npz").returncode == 0
    assert "is one of the captured files" in refusal(*again, frames / "frames.npz")
    np.savez(frames / "mine.npz", a=1)
    assert "is there and is not what an import wrote" in refusal(*again, frames / "mine.npz")
    assert "must end in .npz, .h5, .hdf5" in refusal(*again, frames / "corner.txt")


def test_an_import_that_is_killed_at_any_moment_can_be_repeated(frames):
    out = frames / "there" / "corner.npz"
    sidecar, files = frames / "sidecar.toml", (frames / "frames.npz", frames / "empty.npz")
    import_capture(files[0], sidecar, out, bin_side=2, progress=False)
    for number in range(5):
        killed_before(
            *(number, {"os.rename", "os.remove"}),
            lambda: import_capture(files[1], sidecar, out, bin_side=2, progress=False),
            below=out.parent,
        )
        import_capture(files[0], sidecar, out, bin_side=2, progress=False)
        assert imported_fov_deg(out) is not None


def test_an_import_that_fails_leaves_the_earlier_one(frames, monkeypatch):
    sidecar, out = frames / "sidecar.toml", frames / "corner.npz"
    import_capture(frames / "frames.npz", sidecar, out, bin_side=2, progress=False)
    before = {file: file.read_bytes() for file in (out, record_path(out))}

    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as changed:
        changed.setattr("os.fsync", full)
        with pytest.raises(OSError, match="No space left") as caught:
            import_capture(frames / "empty.npz", sidecar, out, bin_side=2, progress=False)
    assert caught.value.filename == str(out)
    assert {file: file.read_bytes() for file in before} == before
    assert imported_fov_deg(out) is not None


def test_a_capture_that_shows_no_wall_ends_with_exit_code_2_its_findings_and_a_picture(frames):
    done = night_here(
        *("night-eval", "capture", "check", frames / "frames.npz", "--sidecar", frames / "sidecar.toml"),
        *("--set", "phase_sign = -1", "--out", frames / "picture.png", "--json"),
    )
    assert done.returncode == 2
    told = json.loads(done.stdout)
    assert told["refused"] is True
    assert [finding["code"] for finding in told["findings"]] == ["convention"]
    said = " ".join(done.stderr.split())
    assert said.startswith("Error: ")
    assert said.endswith("no capture of a wall to predict from: the phase falls with distance: conjugate?")
    assert said.count("conjugate") == 1
    assert (frames / "picture.png").is_file()


def test_a_measurement_of_another_program_needs_its_field_of_view(frames):
    file = write_npz(frames / "m.npz", phasors=np.stack([PHASOR, PHASOR.conj()]))
    assert "has no record of an import beside it" in refusal("night-eval", "capture", "check", file)
    assert "conjugate? (image 000001)" in refusal("night-eval", "capture", "check", file, "--fov", 60)
    for own, given in (({}, ("--fov", 60)), ({"horizontal_fov_deg": 60.0}, ())):
        write_npz(file, phasors=PHASOR, **own)
        done = night_here("night-eval", "capture", "check", file, *given, "--json")
        assert json.loads(done.stdout)["findings"] == []
    write_npz(file, phasors=np.stack([PHASOR, PHASOR]), horizontal_fov_deg=[60.0, 61.0])
    assert "has images with 2 fields of view: put" in refusal("night-eval", "capture", "check", file)
    assert "raw frames and their options need --sidecar" in refusal(
        "night-eval", "capture", "check", file, "--fov", 60, "--bin", 2
    )


def test_frequencies_in_megahertz_are_refused(tmp_path):
    file = write_npz(tmp_path / "m.npz", phasors=PHASOR, frequencies_hz=np.array([20.0, 50.0, 60.0]))
    said = refusal("night-eval", "capture", "check", file, "--fov", 60)
    assert said.endswith("frequencies_hz must be 1e+06 to 1e+10 Hz (got 20): give Hz, as 20e6 for 20 MHz")


def test_frequencies_that_no_camera_has_are_refused_and_not_searched(tmp_path):
    file = write_npz(tmp_path / "m.npz", phasors=PHASOR, frequencies_hz=np.array([20e6, 50e6, 1e18]))
    said = refusal("night-eval", "capture", "check", file, "--fov", 60)
    assert said.endswith("frequencies_hz must be 1e+06 to 1e+10 Hz (got 1e+18)")
    many = np.arange(1, 18) * 1e6
    file = write_npz(tmp_path / "m.npz", phasors=np.ones((26, 34, 17), complex), frequencies_hz=many)
    assert "has 17 frequencies, and 16 are the most" in refusal(
        "night-eval", "capture", "check", file, "--fov", 60
    )


@pytest.mark.parametrize("fov_deg", [0.5, 200.0, float("nan")])
def test_fields_of_view_that_no_camera_has_are_refused(tmp_path, fov_deg):
    file = write_npz(tmp_path / "m.npz", phasors=PHASOR)
    with pytest.raises(CaptureError, match="no camera sees"):
        check_capture(file, horizontal_fov_deg=fov_deg)


@pytest.mark.parametrize("unit", [1e25, 1e-30])
def test_a_wall_is_found_in_any_unit(unit):
    plain, _ = see_wall(PHASOR, FREQUENCIES_HZ, FOV_DEG)
    fit, _ = see_wall((unit * PHASOR).astype(np.complex64), FREQUENCIES_HZ, FOV_DEG)
    np.testing.assert_allclose(fit.plane_per_m, plain.plane_per_m, atol=2**-22)  # 2^-24 rad, 0.84 rad/m


def test_a_reference_of_another_place_is_told(frames):
    other = wall_of_plane(moved(SLANTED, 0.3, 0.0)).direct
    file = write_npz(frames / "m.npz", phasors=PHASOR, reference=other)
    said = refusal("night-eval", "capture", "check", file, "--fov", 60)
    assert "the wall is not where the reference has it" in said
    file = write_npz(frames / "m.npz", phasors=PHASOR, reference=other.conj())
    said = refusal("night-eval", "capture", "check", file, "--fov", 60)
    assert "the reference: the phase falls with distance" in said


def test_phases_that_drift_after_the_capture_of_the_corner_are_no_finding(tmp_path):
    np.savez(
        tmp_path / "corner.npz",
        phasors=PHASOR * np.exp(0.03j * np.array([1, -1, 1])),
        reference=PHASOR,
        frequencies_hz=FREQUENCIES_HZ,
    )
    done = check_capture(tmp_path / "corner.npz", horizontal_fov_deg=FOV_DEG)
    assert not done.refused
    assert not done.found.warnings
