"""What makes phasors no image of a wall, or of the frequencies that they should have, is said in words."""

import re

import numpy as np
import pytest
from captures import IMAGES, write_sidecar
from wall_measurements import FOV_DEG, FREQUENCIES_HZ, IMAGE_DEFECTS, noise, planes_mixed, wall_of_plane

from itof.capture.checking import check_capture
from itof.capture.image_check import check_image
from itof.capture.importing import import_capture
from itof.capture.sidecar import CaptureError

WALL = wall_of_plane()
PHASOR = WALL.direct * (1 + 2e-4 * noise(WALL.direct.shape))
OFFSETS = np.exp(1j * np.array([0.5, 1.4, -2.0]))


def sentence(phasor):
    (found,) = check_image(phasor, FREQUENCIES_HZ, FOV_DEG).findings
    return found.sentence, found.refused


def test_phases_of_noise_are_called_noise_by_check_and_import(tmp_path):
    words, refused = sentence(np.abs(PHASOR) * np.exp(1j * np.angle(noise(PHASOR.shape))))
    assert words.startswith("the phases at 20, 50, 60 MHz are noise")
    assert refused
    spoilt = PHASOR.copy()
    spoilt[..., 1] = noise(PHASOR.shape[:2])
    assert sentence(spoilt)[0].startswith("the phases at 50 MHz are noise")
    sidecar = write_sidecar(tmp_path / "sidecar.toml", IMAGES | {"layout": "phasors", "arrays": ["z"]})
    np.savez(tmp_path / "frames.npz", z=spoilt)
    with pytest.raises(CaptureError, match="the phases at 50 MHz are noise"):
        import_capture(tmp_path / "frames.npz", sidecar, tmp_path / "out.npz", progress=False)


@pytest.mark.parametrize(
    ("declared_mhz", "wrong", "true", "offsets"),
    [
        ((20, 50, 65), 65, 60, OFFSETS),
        ((20, 40, 60), 40, 50, 1.0),
        pytest.param((25, 50, 60), 25, 20, OFFSETS, marks=pytest.mark.long),
        pytest.param((20, 50, 120), 120, 60, 1.0, marks=pytest.mark.long),
    ],
)
def test_a_frequency_that_does_not_fit_the_others_is_named(declared_mhz, wrong, true, offsets):
    declared_hz = tuple(1e6 * each for each in declared_mhz)
    (found,) = check_image(PHASOR * offsets, declared_hz, FOV_DEG).findings
    assert found.refused
    assert found.sentence.startswith(f"the phases at {wrong} MHz do not fit those at ")
    # Frequencies that differ by less are taken for the waves of a camera.
    assert float(found.sentence.split()[-2]) == pytest.approx(true, rel=0.02)


def test_of_two_frequencies_either_may_be_wrong():
    wall = wall_of_plane(frequencies_hz=(40e6, 70e6))
    (found,) = check_image(wall.direct, (40e6, 80e6), FOV_DEG).findings
    words = (
        r"the phases at 40 and 80 MHz do not fit each other: is one of them (.*) or (.*) MHz, respectively\?"
    )
    told_mhz = [float(each) for each in re.fullmatch(words, found.sentence).groups()]
    np.testing.assert_allclose(told_mhz, [40 * 80 / 70, 70], rtol=0.02)  # less would be a camera's waves


@pytest.mark.parametrize("name", [name for name in IMAGE_DEFECTS if name != "one depth"])
def test_what_is_no_image_is_told_by_what_is_wrong(name):
    spoil, code, words = IMAGE_DEFECTS[name]
    (found,) = check_image(np.ascontiguousarray(spoil(PHASOR, WALL)), FREQUENCIES_HZ, FOV_DEG).findings
    assert (found.code, found.refused) == (code, True)
    assert words in found.sentence


def test_advice_for_mixed_planes_does_not_depend_on_further_errors():
    wall = wall_of_plane(frequencies_hz=(40e6, 70e6))
    wrong = planes_mixed(wall.direct, wall)
    for z in (wrong, wrong.conj()[..., ::-1]):
        (found,) = check_image(z, wall.frequencies_hz, FOV_DEG).findings
        assert found.sentence.endswith("at 40 MHz and the real part at 70 MHz belong together")


def test_one_depth_for_all_frequencies_holds_no_hidden_light_but_a_computed_wall_is_fine(tmp_path):
    bump_m = 1e-3 * np.cos(np.linspace(0, 9, PHASOR.shape[1]))
    depth_m = np.round(WALL.radial_depth_m + bump_m, 4)
    sidecar = IMAGES | {"layout": "amplitude-depth", "arrays": ["d"] * 3, "amplitude_arrays": ["a"] * 3}
    file = write_sidecar(
        tmp_path / "sidecar.toml", sidecar, axes=["row", "column"], stacked_along="frequency"
    )
    np.savez(tmp_path / "depth.npz", d=depth_m, a=np.abs(PHASOR[..., 0]))
    (found,) = check_capture(tmp_path / "depth.npz", file, progress=False).found.findings
    assert (found.code, found.refused) == ("no-hidden-light", True)
    assert "are those of one depth image" in found.sentence
    with pytest.raises(CaptureError, match="are those of one depth image"):
        import_capture(tmp_path / "depth.npz", file, tmp_path / "out.npz", progress=False)
    assert check_image(WALL.direct, FREQUENCIES_HZ, FOV_DEG).findings == ()


@pytest.mark.parametrize(("share", "is_told"), [(0.0, False), (0.015, False), (0.2, True)])
def test_an_error_of_the_hidden_light_is_no_seam(share, is_told):
    """Renders for a training may be off by 4 % of the hidden light, which is most at the edge of an image."""
    wall, away = wall_of_plane(width=80, height=60), np.linspace(0, np.pi, 80)[:, None]
    hidden = 1e-3 * np.cos(away) * np.array([1.0, -2.0, 0.5])  # (W, F)
    hidden[0] += share * np.sqrt((hidden**2).mean())
    found = check_image(wall.direct * np.exp(1j * hidden), FREQUENCIES_HZ, FOV_DEG).findings
    assert any("a seam near column 1" in each.sentence for each in found) == is_told
