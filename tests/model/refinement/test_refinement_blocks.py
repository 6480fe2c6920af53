"""Blocks of pixels, by which a measurement and a model are compared."""

import numpy as np
import pytest

from itof import pixel_rays
from model.refinement.blocks import Blocks


def kinked(rays):
    """A smooth image that is darker beyond a slanted line, as behind the end of a shadow."""
    x, y = (rays[..., axis] / rays[..., 2] for axis in (0, 1))
    return 1 + 0.3 * x**2 - 0.2 * x * y + np.minimum(0, 0.2 * x + 0.5 * y - 0.013)


def smooth(rays):
    x, y = (rays[..., axis] / rays[..., 2] for axis in (0, 1))
    return 1 + 0.3 * x**2 - 0.2 * x * y


@pytest.mark.parametrize(
    ("width", "height", "rows"), [(80, 60, 15), (80, 60, 10), (40, 30, 15), (325, 245, 10)]
)
def test_means_of_parts_are_those_of_pixels_also_where_a_shadow_ends(width, height, rows):
    blocks, rays = Blocks.of(height, rows), pixel_rays(width, height, 60.0)
    measured = blocks.middles(kinked(rays)[..., None])
    where = np.isfinite(measured).all(axis=-1)
    parts = blocks.rays_of_parts(rays, where)
    model = blocks.middles_of_parts(kinked(parts)[..., None], where)
    middles = blocks.middles(rays)
    in_middles = kinked(middles / np.linalg.norm(middles, axis=-1, keepdims=True))
    away, without = (
        np.abs(measured[..., 0] - each.reshape(where.shape)).max() for each in (model, in_middles)
    )
    # A kink of slope s changes the mean of a part of width p by s p / 8 at most; parts are half as wide.
    assert away < without / 2


def test_the_middle_of_a_block_has_the_value_of_a_quadratic_image_there():
    blocks, rays = Blocks.of(60, 15), pixel_rays(80, 60, 60.0)
    found = blocks.middles(smooth(rays)[..., None])[..., 0]
    x, y = (blocks.middles(rays[..., [axis]] / rays[..., 2:])[..., 0] for axis in (0, 1))
    np.testing.assert_allclose(found, 1 + 0.3 * x**2 - 0.2 * x * y, atol=1e-12)


def test_a_block_with_a_pixel_that_is_unknown_is_unknown_and_its_neighbours_are_not():
    blocks, image = Blocks.of(60, 15), np.ones((60, 80, 1))
    image[17, 42] = np.nan
    found = blocks.middles(image)[..., 0]
    assert np.isnan(found[4, 10])
    assert np.isfinite(found).sum() == found.size - 1


def test_white_noise_of_pixels_has_the_stated_gain():
    blocks, rng = Blocks.of(600, 100), np.random.default_rng(3)
    noise = blocks.middles(rng.standard_normal((600, 800, 1)))[1:-1, 1:-1]
    # 13,000 independent values: 0.6 % of standard deviation, and four of these
    assert noise.std() == pytest.approx(blocks.gain_of_noise, rel=0.025)
