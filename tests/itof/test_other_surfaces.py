"""Residual channels are 0 where the image shows something else than the relay wall, or its edge."""

import numpy as np
import pytest
import torch

from itof import direct_phasors, phase_per_metre, residual_channels

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT, FINER = 40, 30, 4
EDGE = 125  # sub-pixels from the left: column 31 has a quarter of its light


def wall(width: int, height: int, distance_m: float = 2.0) -> np.ndarray:
    """(H, W, F) direct return of a wall that is seen from the side."""
    axes = np.array([[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]])
    origin, point, normal = (0, 0, 0), (0, 0, distance_m), (0, 0, -1)
    return direct_phasors(width, height, 60.0, FREQUENCIES_HZ, axes, origin, point, normal)


def cut(distance_beyond_m: float | None = None) -> np.ndarray:
    """(H, W, F) mean of sub-pixels; from `EDGE` on they are dark, or show a nearer surface."""
    fine = wall(FINER * WIDTH, FINER * HEIGHT)
    fine[:, EDGE:] = 0 if distance_beyond_m is None else wall(*fine.shape[1::-1], distance_beyond_m)[:, EDGE:]
    return fine.reshape(HEIGHT, FINER, WIDTH, FINER, -1).mean(axis=(1, 3))


def hidden_light(reference: np.ndarray, share: float) -> np.ndarray:
    """Light of a path that is 6 m longer, as a share of the direct light."""
    return share * reference * np.exp(6j * phase_per_metre(FREQUENCIES_HZ))


@pytest.mark.parametrize("beyond_m", [None, 1.2])
def test_the_edge_of_a_surface_before_the_wall_is_left_out_and_all_else_stays(beyond_m):
    reference = wall(WIDTH, HEIGHT)
    seen = cut(beyond_m) + hidden_light(reference, 2e-3)
    kept = residual_channels(seen, reference)
    hidden = residual_channels(reference + hidden_light(reference, 2e-3), reference)
    # The edge is more than ten times the hidden light.
    assert np.abs(kept[:3, :, 31]).max(axis=0).min() > 10 * np.abs(hidden[:3]).max()
    alone = residual_channels(seen, reference, wall_alone=True)
    assert not alone[:, :, 31:].any()
    np.testing.assert_array_equal(alone[:, :, :30], kept[:, :, :30])  # column 30 has the edge beside it


def test_strong_hidden_light_is_no_edge():
    reference = wall(WIDTH, HEIGHT)
    seen = reference + hidden_light(reference, 0.045)
    expected = residual_channels(seen, reference)
    assert np.abs(expected[:3]).max() > 0.03
    np.testing.assert_array_equal(residual_channels(seen, reference, wall_alone=True), expected)


@pytest.mark.parametrize("wall_alone", [True, False])
def test_noise_of_pixels_that_show_no_wall_is_no_hidden_light(wall_alone):
    """A black middle wall at the right, before a wall that gets darker towards it, to a fifth."""
    reference = wall(WIDTH, HEIGHT)
    dark = np.arange(WIDTH) >= 32
    seen = (reference + hidden_light(reference, 2e-3)) * np.linspace(1, 0.2, WIDTH)[:, None]
    turns = np.random.default_rng(0).random((HEIGHT, WIDTH, 1))
    noise = 3e-4 * np.abs(reference).mean() * np.exp(2j * np.pi * turns)
    found = residual_channels(np.where(dark[:, None], noise, seen), reference, wall_alone=wall_alone)
    assert not found[..., dark].any()
    inside = np.arange(WIDTH) < 30  # apart from pixels at the edge
    expected = residual_channels(seen, reference, wall_alone=wall_alone)
    np.testing.assert_array_equal(found[..., inside], expected[..., inside])


def test_each_image_has_its_own_pixels_left_out_in_numpy_and_in_torch():
    reference = wall(WIDTH, HEIGHT)
    images = np.stack([reference, cut()]) * 1.001
    found = residual_channels(images, reference, wall_alone=True)
    for image, channels in zip(images, found, strict=True):
        np.testing.assert_array_equal(residual_channels(image, reference, wall_alone=True), channels)
    of_torch = residual_channels(torch.from_numpy(images), torch.from_numpy(reference), wall_alone=True)
    np.testing.assert_allclose(of_torch.numpy(), found, rtol=0, atol=1e-7)
