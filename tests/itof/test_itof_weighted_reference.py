"""The reference of the residual channels on walls that are not Lambertian: closed forms and renders."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from many_light_scenes import CAMERA_LOCATION_M, DOWN, FORWARD, HORIZONTAL_FOV_DEG, RIGHT

from itof import (
    TransientLayout,
    direct_phasors,
    phase_per_metre,
    pixel_rays,
    residual_channels,
    weighted_reference,
)
from model.data.channel_scaling import fit_input_spec
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import View

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
AXES = np.array([RIGHT, DOWN, FORWARD])
FINE = 32  # points per pixel and axis: the variance of their places is 1/12 within 0.1 %


def lambertian(width, height, subpixels=FINE):
    wall = ((0.0, 0.0, 2.0), (1.0, 0.0, 0.0))
    camera = (AXES, CAMERA_LOCATION_M, *wall)
    return direct_phasors(width, height, HORIZONTAL_FOV_DEG, FREQUENCIES_HZ, *camera, subpixels=subpixels)


def glossy(width, height, power=2.0):
    """(H, W, F) direct return of the paper's wall if its lobe were cos^power a for co-located light."""
    rays = pixel_rays(width * FINE, height * FINE, HORIZONTAL_FOV_DEG)
    cosine = np.abs((rays @ AXES)[..., 0])
    distance_m = CAMERA_LOCATION_M[0] / cosine
    radiance = cosine ** (1 + power) / (distance_m**2 * rays[..., 2] ** 3)
    opl_m = 2 * distance_m
    parts = [radiance * np.exp(1j * k * opl_m) for k in phase_per_metre(FREQUENCIES_HZ)]
    return np.stack(parts, axis=-1).reshape(height, FINE, width, FINE, -1).mean(axis=(1, 3))


def left(measured, reference, weights):
    """Root mean square of Im r_f, which is 0 if the reference is right."""
    return np.sqrt((residual_channels(measured, reference, weights)[:3] ** 2).mean())


def test_what_is_left_of_a_glossy_wall_falls_with_the_fourth_power_of_the_pixel_instead_of_the_second():
    pairs = [(glossy(*size), lambertian(*size)) for size in ((20, 15), (40, 30))]
    coarse, fine = ({w: left(*pair, w) for w in ("uniform", "measured")} for pair in pairs)
    # The next term is h² of this one, 1/225 at 20 x 15; its factor may be ten.
    assert np.log2(coarse["uniform"] / fine["uniform"]) == pytest.approx(2, abs=10 / 225)
    assert np.log2(coarse["measured"] / fine["measured"]) > 3.5
    assert fine["measured"] < fine["uniform"] / 100


def test_a_lambertian_wall_and_a_captured_reference_are_left_as_they_are():
    plain = lambertian(20, 15)
    np.testing.assert_allclose(weighted_reference(plain, 3.0 * np.abs(plain[..., 0])), plain, rtol=1e-12)
    capture = glossy(20, 15)
    assert np.abs(residual_channels(7 * capture, capture)).max() < 1e-7


@pytest.mark.parametrize("axis", [0, 1])
def test_an_edge_and_dark_pixels_do_not_disturb_their_neighbours(axis):
    measured, reference = glossy(40, 30), lambertian(40, 30)
    whole = residual_channels(measured, reference)
    shade = np.ones((30, 40, 1))
    np.moveaxis(shade, axis, 0)[:10] = 0.3  # paint
    np.moveaxis(shade, axis, 0)[:4] = 0.0  # the black middle wall
    changed = residual_channels(shade * measured, reference)
    lit = shade[..., 0] > 0
    assert not changed[:, ~lit].any()
    # One-sided gradients beside the edges have twice the error of central ones, as at the image's border.
    assert np.abs(changed[:, lit]).max() < 2 * np.abs(whole).max()
    assert np.abs(whole).max() < np.abs(residual_channels(measured, reference, "uniform")).max() / 100


def test_images_of_one_row_or_column_and_unlit_references_work():
    for shape in ((1, 1), (1, 9), (9, 1), (2, 2)):
        z = np.full((*shape, 3), 0.5 + 0.1j)
        assert np.abs(residual_channels(z, z)).max() < 1e-6
        assert not residual_channels(z, 0 * z).any()


def test_unknown_weights_are_refused():
    z = lambertian(4, 3)
    with pytest.raises(ValueError, match="measured or uniform, got 'glossy'"):
        residual_channels(z, z, "glossy")


def test_a_batch_of_torch_tensors_is_weighted_image_by_image():
    reference = lambertian(20, 15)
    images = np.stack([glossy(20, 15, power) for power in (0.0, 1.0, 3.0)])
    tensors = (torch.from_numpy(array.astype(np.complex64)) for array in (images, reference))
    together = residual_channels(*tensors).numpy()
    each = np.stack([residual_channels(image, reference) for image in images])
    np.testing.assert_allclose(together, each, rtol=0, atol=5e-7)


def test_a_run_knows_how_its_reference_was_weighted(shards):
    rows = shards.rows("train")
    now = fit_input_spec("residual", shards, rows)
    assert now.subpixel_weights == "measured"
    before = replace(now, subpixel_weights="uniform")  # as in version 0.1
    z = shards.read(rows[:1]).phasors[0]
    turned = z / shards.reference
    expected = (turned / np.abs(turned[..., :1])).imag / np.array(now.residual_scale[:3])
    np.testing.assert_allclose(np.moveaxis(before.apply(z, shards.reference)[:3], 0, -1), expected, atol=1e-5)


def test_less_than_one_percent_of_the_hidden_light_is_left_on_a_rough_wall_at_40_by_30(four_shapes, variant):
    """Roughness 0.3; the direct part of many-light is exact, and the lights need not be many."""
    layout = TransientLayout(40, 30, 1400, 0.01, 0.0)
    method = ManyLight(ManyLightOptions(lights=128), variant)
    image = method.expose(four_shapes["sphere"], View(layout, FREQUENCIES_HZ, 3, 1)).phasors()
    reference = lambertian(40, 30, subpixels=8)
    hidden = residual_channels(image.total, image.direct, "uniform")[:3]  # the reference is right
    error = {
        weights: np.linalg.norm(residual_channels(image.total, reference, weights)[:3] - hidden)
        / np.linalg.norm(hidden)
        for weights in ("uniform", "measured")
    }
    assert error["uniform"] > 0.01
    assert error["measured"] < 0.01
