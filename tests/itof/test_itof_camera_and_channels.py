"""Pinhole geometry, the direct return, and the network channels."""

import tracemalloc

import numpy as np
import pytest
import torch

from itof import (
    direct_phasors,
    network_channels,
    phase_per_metre,
    pixel_rays,
    points_from_radial,
    radial_from_z,
    residual_channels,
    z_from_radial,
)

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
FACING_THE_WALL = np.eye(3)  # camera axes right, down, forward = world x, y, z


def test_the_outermost_pixel_edges_span_the_field_of_view():
    rays = pixel_rays(8, 6, 60.0)
    x_over_z = rays[3, :, 0] / rays[3, :, 2]
    half_pixel = (x_over_z[1] - x_over_z[0]) / 2
    assert np.degrees(np.arctan(x_over_z[-1] + half_pixel)) == pytest.approx(30.0, abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0)


def test_rows_go_down_and_columns_go_right_with_square_pixels():
    rays = pixel_rays(8, 6, 60.0)
    tangents = rays[..., :2] / rays[..., 2:]
    np.testing.assert_allclose(tangents[0, 1, 0] - tangents[0, 0, 0], tangents[1, 0, 1] - tangents[0, 0, 1])
    assert tangents[0, 0, 0] < 0
    assert tangents[0, 0, 1] < 0


def test_a_plane_across_the_optical_axis_has_one_z_depth():
    z_depth_m = np.full((6, 8), 2.5)
    radial_depth_m = radial_from_z(z_depth_m, 60.0)
    assert radial_depth_m.max() > 2.5
    np.testing.assert_allclose(z_from_radial(radial_depth_m, 60.0), z_depth_m)
    np.testing.assert_allclose(points_from_radial(radial_depth_m, 60.0)[..., 2], 2.5)


def test_the_direct_return_of_a_facing_wall_has_its_closed_form():
    # Facing wall at distance h: r = h / cos o and cos a = cos o, so L = cos o / (r^2 cos^3 o) = 1 / h^2.
    z = direct_phasors(8, 6, 60.0, [1.0], FACING_THE_WALL, (0, 0, 0), (0, 0, 1.5), (0, 0, -1))
    np.testing.assert_allclose(np.abs(z), 1 / 1.5**2, rtol=1e-9)


def test_the_direct_return_does_not_depend_on_where_its_arrays_lie_in_memory():
    # numpy rounds the cube of a strided array differently if the result lies right behind it: here in 5 %.
    rng = np.random.default_rng(0)
    others, found = [], set()
    for _ in range(1000):
        others.append(np.empty(rng.integers(1, 2000)))  # moves what is allocated next
        if len(others) > 50:
            others.pop(rng.integers(50))
        z = direct_phasors(2, 2, 60.0, FREQUENCIES_HZ, FACING_THE_WALL, (0, 0, 0), (0, 0, 1.5), (0, 0, -1))
        found.add(z.tobytes())
    assert len(found) == 1


def test_the_direct_return_of_a_large_image_is_made_in_blocks_of_rows():
    width, height, subpixels = 64, 256, 8  # 2^20 rays: 8 MB for each number of a ray
    tracemalloc.start()
    z = direct_phasors(width, height, 60.0, [1.0], FACING_THE_WALL, (0, 0, 0), (0, 0, 1.5), (0, 0, -1))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert z.shape == (height, width, 1)
    np.testing.assert_allclose(np.abs(z), 1 / 1.5**2, rtol=1e-9)
    assert peak_bytes < 8 * width * height * subpixels**2 * 6  # all rays at once are 3, their phasors 2 more


def test_rays_of_some_rows_are_those_of_the_whole_image():
    np.testing.assert_array_equal(pixel_rays(8, 6, 60.0, rows=(2, 5)), pixel_rays(8, 6, 60.0)[2:5])


def test_the_phase_of_the_direct_return_is_that_of_twice_the_distance():
    z = direct_phasors(64, 48, 10.0, [20e6], FACING_THE_WALL, (0, 0, 0), (0, 0, 1.5), (0, 0, 1))
    distance_m = 1.5 / pixel_rays(64, 48, 10.0)[..., 2]
    expected = 2 * distance_m * phase_per_metre(20e6)
    # Averaging over a pixel of angle p shifts the mean path by about h p^2 / 12, here 1e-6 m.
    np.testing.assert_allclose(np.angle(z[..., 0]), expected, atol=1e-5)


def test_rays_that_miss_the_wall_return_nothing():
    z = direct_phasors(8, 6, 60.0, [20e6], FACING_THE_WALL, (0, 0, 0), (0, 0, -1.5), (0, 0, 1))
    assert not z.any()


def test_the_papers_seven_channels_are_in_the_papers_order():
    z = np.full((6, 8, 3), 2.0j) * np.array([1.0, 0.5, 0.25])
    channels = network_channels(z, amplitude_scale=4.0)
    assert channels.shape == (7, 6, 8)
    assert channels.dtype == np.float32
    np.testing.assert_allclose(channels[:, 3, 5], [0.5, 0, 0, 0, 1, 0.5, 0.25], atol=1e-7)


@pytest.mark.parametrize("frequency_count", [1, 2, 5])
def test_channels_invert_for_any_number_of_frequencies(frequency_count):
    rng = np.random.default_rng(1)
    z = rng.standard_normal((2, 6, 8, frequency_count, 2)) @ np.array([1, 1j])
    channels = network_channels(z, 0.3)
    assert channels.shape == (2, 1 + 2 * frequency_count, 6, 8)
    again = (
        0.3
        * channels[:, :1]
        * (channels[:, 1 : 1 + frequency_count] + 1j * channels[:, 1 + frequency_count :])
    )
    np.testing.assert_allclose(np.moveaxis(again, 1, -1), z, rtol=0, atol=1e-6)  # float32


def test_dark_pixels_become_zero_in_every_channel():
    z = np.zeros((6, 8, 3), complex)
    assert not network_channels(z, 1.0).any()
    assert not residual_channels(z, np.ones_like(z)).any()


def test_residual_channels_of_the_direct_return_alone_are_zero():
    reference = direct_phasors(8, 6, 60.0, FREQUENCIES_HZ, FACING_THE_WALL, (0, 0, 0), (0, 0, 2), (0, 0, 1))
    # At 8x6 pixels |reference| differs between frequencies by 4 %, which must drop out as well.
    residual = residual_channels(3.7 * reference, reference)
    assert residual.shape == (5, 6, 8)
    assert np.abs(residual).max() < 1e-6


def test_residual_channels_see_a_hidden_return_to_first_order():
    reference = direct_phasors(8, 6, 60.0, FREQUENCIES_HZ, FACING_THE_WALL, (0, 0, 0), (0, 0, 2), (0, 0, 1))
    unit = reference / np.abs(reference)
    reference = unit
    hidden = 2e-3 * np.exp(1j * phase_per_metre(FREQUENCIES_HZ) * 9.0) * np.ones_like(unit)
    residual = residual_channels(unit + hidden, reference, "uniform")
    turned = hidden * np.conj(unit)
    expected = np.concatenate([turned.imag, turned.real[..., 1:] - turned.real[..., :1]], axis=-1)
    # Dividing by |z_20| instead of 1 changes the hidden part by its own relative size.
    np.testing.assert_allclose(residual, np.moveaxis(expected, -1, 0), atol=2 * (2e-3) ** 2)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_an_amplitude_scale_that_is_no_positive_number_is_refused(scale):
    with pytest.raises(ValueError, match="positive number"):
        network_channels(np.ones((6, 8, 3), complex), scale)


def wall(distance_m: float = 2.0, fov_deg: float = 60.0) -> np.ndarray:
    """(6, 8, F) direct return of a wall straight ahead."""
    origin, point, normal = (0, 0, 0), (0, 0, distance_m), (0, 0, 1)
    return direct_phasors(8, 6, fov_deg, FREQUENCIES_HZ, FACING_THE_WALL, origin, point, normal)


def hidden_light(direct: np.ndarray) -> np.ndarray:
    """A hidden return of 0.2 %, of another path in every pixel."""
    opl_m = np.random.default_rng(3).uniform(6, 9, (*direct.shape[:2], 1))
    return 2e-3 * np.abs(direct) * np.exp(1j * opl_m * phase_per_metre(FREQUENCIES_HZ))


def test_a_millimetre_of_wrong_wall_shows_in_im_as_its_phase_and_in_re_to_second_order():
    right, wrong = wall(2.0, 6.0), wall(2.001, 6.0)  # narrow: no spread of paths within a pixel
    distance_m = 1e-3 / pixel_rays(8, 6, 6.0)[..., 2]  # (6, 8) along each ray
    phase_error = -2 * distance_m[..., None] * phase_per_metre(FREQUENCIES_HZ)  # out and back
    residual = residual_channels(right, wrong)
    # A pixel of angle p = 6 / 8 degrees averages over paths that are longer by p^2 / 12 = 1.4e-5.
    np.testing.assert_allclose(np.moveaxis(residual[:3], 0, -1), phase_error, rtol=2e-5)
    assert np.abs(phase_error[3, 4]).round(4).tolist() == [0.0008, 0.0021, 0.0025]
    first = phase_error[..., :1]
    second_order = (first**2 - phase_error[..., 1:] ** 2) / 2  # cos e_f - cos e_0
    np.testing.assert_allclose(np.moveaxis(residual[3:], 0, -1), second_order, rtol=1e-2, atol=1e-8)
    # With hidden light: its own part of Re changes by its size times the phase, 1e-3 of it.
    z = right + hidden_light(right)
    change = residual_channels(z, wrong)[3:] - residual_channels(z, right)[3:]
    assert np.abs(change).max() < 4 * 2e-3 * np.abs(phase_error).max() + np.abs(second_order).max()


def test_a_wrong_gain_of_the_sensor_drops_out_of_the_residual_channels():
    reference = wall()
    z = reference + hidden_light(reference)
    one, thousand = residual_channels(z, reference), residual_channels(1000 * z, reference)
    np.testing.assert_allclose(one, thousand, rtol=0, atol=1e-9)


def test_channels_of_torch_tensors_are_those_of_numpy_arrays():
    reference = wall()
    z = reference + hidden_light(reference)
    tensors = [torch.from_numpy(array.astype(np.complex64)) for array in (z, reference)]
    residual = residual_channels(*tensors)
    assert residual.dtype == torch.float32
    # complex64: a few roundings of 6e-8 of the direct part, 3e-5 of the hidden.
    np.testing.assert_allclose(residual.numpy(), residual_channels(z, reference), rtol=0, atol=5e-7)
    np.testing.assert_allclose(
        network_channels(tensors[0], 0.2).numpy(), network_channels(z, 0.2), rtol=1e-5, atol=1e-6
    )
