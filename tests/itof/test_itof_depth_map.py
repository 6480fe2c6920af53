"""Depth maps: what is read is what was written, and what is no depth map is refused by name."""

import numpy as np
import pytest

from itof import DepthMap, ImageFileError, pixel_rays, read_image, write_image

HEIGHT, WIDTH = 5, 8  # not square: a transpose would show
SPEED_OF_LIGHT = 299_792_458.0
FOV_DEG = 60.0


@pytest.fixture
def truth():
    """An object on some pixels, at a different depth in each."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    mask = (rows > 0) & (columns > 2) & (columns < 7)
    depth_m = np.where(mask, 2 + 0.3 * rows + 0.1 * columns, 0.0)
    return DepthMap.of_object(depth_m, mask, 20e6)


@pytest.fixture
def channels(truth):
    return truth.channels()


def refusal(tmp_path, channels):
    """What is said of an EXR file with these channels; it must name the file."""
    file = tmp_path / "depth.exr"
    write_image(file, channels, {})
    with pytest.raises(ImageFileError) as refused:
        DepthMap.read(file)
    assert str(refused.value).startswith(f"{file} ")
    return str(refused.value)


def test_the_phasor_of_an_object_has_amplitude_1_and_the_phase_of_the_way_there_and_back(truth):
    np.testing.assert_allclose(np.abs(truth.phasor), truth.mask, atol=1e-15)
    expected = np.exp(2j * np.pi * 20e6 * 2 * truth.radial_depth_m / SPEED_OF_LIGHT)
    np.testing.assert_allclose(truth.phasor[truth.mask], expected[truth.mask], rtol=1e-12)


def test_what_is_read_is_what_was_written(truth, tmp_path):
    file = tmp_path / "mirrored.exr"
    truth.write(file, {"scene_id": "000007"})
    found = DepthMap.read(file)
    assert found.radial_depth_m.shape == found.mask.shape == found.phasor.shape == (HEIGHT, WIDTH)
    # Stored as float32: half a unit in the last of 24 bits.
    np.testing.assert_allclose(found.radial_depth_m, truth.radial_depth_m, rtol=2**-24)
    np.testing.assert_allclose(found.phasor, truth.phasor, atol=2**-23)
    np.testing.assert_array_equal(found.mask, truth.mask)
    assert found.mask.dtype == bool
    assert found.frequency_hz == 20e6
    assert read_image(file).attributes["scene_id"] == "000007"


def test_a_depth_map_is_two_lines_in_a_shell(truth):
    first, second = repr(truth).split("\n")
    assert first == "DepthMap of 8 x 5 pixels, with its phasor at 20 MHz"
    assert second == "16 pixels of an object, at 2.60 to 3.80 m"  # columns 3 to 6 of rows 1 to 4
    two = DepthMap.of_object(np.zeros((2, 5, 8)), np.zeros((2, 5, 8), dtype=bool), 20e6)
    assert repr(two).split("\n") == [
        "DepthMap of 2 images of 8 x 5 pixels, with its phasor at 20 MHz",
        "0 pixels of an object",
    ]


def test_z_depth_is_measured_along_the_optical_axis(truth):
    cosine = pixel_rays(WIDTH, HEIGHT, FOV_DEG)[..., 2]  # unit rays; the axis is z
    np.testing.assert_allclose(truth.z_depth_m(FOV_DEG), truth.radial_depth_m * cosine, rtol=1e-12)
    assert not truth.z_depth_m(FOV_DEG)[~truth.mask].any()


def test_one_of_several_depth_maps_can_be_taken(truth):
    several = DepthMap(
        *(np.stack([0 * a, a]) for a in (truth.radial_depth_m, truth.mask, truth.phasor)), 20e6
    )
    np.testing.assert_array_equal(several[1].radial_depth_m, truth.radial_depth_m)
    np.testing.assert_array_equal(several[1].mask, truth.mask)
    np.testing.assert_array_equal(several[1].phasor, truth.phasor)
    assert several[1].frequency_hz == 20e6


@pytest.mark.parametrize("name", ["depth.R", "mask.M", "itof.20MHz.Re", "itof.20MHz.Im"])
def test_a_missing_channel_is_refused(channels, tmp_path, name):
    del channels[name]
    assert "is no depth map" in refusal(tmp_path, channels)


def test_phasors_at_two_frequencies_are_refused(channels, tmp_path):
    more = {name.replace("20MHz", "50MHz"): values for name, values in channels.items() if "20MHz" in name}
    assert "phasors at 2 frequencies" in refusal(tmp_path, channels | more)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("depth.R", np.nan),
        ("depth.R", np.inf),
        ("mask.M", np.nan),
        ("itof.20MHz.Re", np.inf),
        ("itof.20MHz.Im", np.nan),
    ],
)
def test_values_that_are_not_finite_are_refused_with_their_number(channels, tmp_path, name, value):
    channels[name][1, 2:4] = value
    assert "holds 2 values that are NaN or infinite" in refusal(tmp_path, channels)


@pytest.mark.parametrize(("name", "value"), [("mask.M", 0.5), ("mask.M", -1.0), ("depth.R", -0.1)])
def test_a_mask_that_is_not_0_or_1_and_a_negative_depth_are_refused(channels, tmp_path, name, value):
    channels[name][2, 3] = value
    assert "it needs mask.M of 0 and 1 and depth.R from 0 m" in refusal(tmp_path, channels)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ImageFileError, match=r"nowhere\.exr"):
        DepthMap.read(tmp_path / "nowhere.exr")
