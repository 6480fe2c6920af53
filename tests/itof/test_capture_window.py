"""A part of the sensor beside its middle, and lens coefficients that lead from pixels to rays."""

import numpy as np
import pytest
from captures import IMAGES, raw_of, sidecar_of
from wall_measurements import FREQUENCIES_HZ, SLANTED

from itof import pixel_rays
from itof.capture.capture import capture_of
from itof.capture.lens import Undistortion, ray_of, seen_at
from itof.capture.sidecar import CaptureError, Lens
from itof.wall.expected_wall import ExpectedWall

WIDTH, HEIGHT, FOV_DEG = 96, 72, 70.0
PINHOLE = Lens(fx=68.551, fy=68.551, cx=47.5, cy=35.5)  # 48 / tan(35 degrees)
STRONG = {"k1": 0.2, "k2": -0.1, "k3": 0.05, "p1": 0.01, "p2": -0.02}
RAYS = pixel_rays(WIDTH, HEIGHT, FOV_DEG)


def scene(rays):
    """(..., 1) light from rays (..., 3) of the camera: smooth, with a phase that is linear in the place."""
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    return ((1.5 + x - 0.5 * y) * np.exp(1j * (3 * x + 2 * y)))[..., None]


# Linear interpolation errs by at most (|f_xx| + |f_yy|) / 8 in pixels, and these are below 33 and 16.
BOUND = (3**2 * 3 + 2 * 3 + 2**2 * 3 + 2 * 2) / 8 / 68**2


@pytest.mark.parametrize("maps_to", ["pixel", "ray"])
def test_a_pixel_sees_the_ray_that_leads_to_it(maps_to):
    lens = Lens(fx=68.0, fy=67.0, cx=46.0, cy=37.0, maps_to=maps_to, **STRONG)
    for column, row in [(0, 0), (95, 71), (46, 37), (80, 10)]:
        x, y = ray_of(lens, column, row)
        np.testing.assert_allclose(seen_at(lens, np.array(x), np.array(y)), (column, row), atol=1e-6)


def test_coefficients_that_lead_to_rays_are_the_equation_of_the_pixels_place():
    lens = Lens(fx=68.0, fy=67.0, cx=46.0, cy=37.0, maps_to="ray", **STRONG)
    plain = Lens(fx=1.0, fy=1.0, cx=0.0, cy=0.0, **STRONG)
    u, v = (80 - 46) / 68, (10 - 37) / 67
    np.testing.assert_allclose(ray_of(lens, 80, 10), seen_at(plain, np.array(u), np.array(v)), atol=1e-12)


def test_an_image_whose_coefficients_lead_to_rays_becomes_that_of_a_pinhole_camera():
    lens = Lens(fx=80.0, fy=80.0, cx=46.0, cy=37.0, maps_to="ray", **STRONG)
    plain = Lens(fx=1.0, fy=1.0, cx=0.0, cy=0.0, **STRONG)
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    x, y = seen_at(plain, (column - lens.cx) / lens.fx, (row - lens.cy) / lens.fy)
    image = scene(np.stack([x, y, np.ones_like(x)], axis=-1))
    straight = Undistortion.of(lens, WIDTH, HEIGHT, 60.0)
    good = straight.good(np.ones((HEIGHT, WIDTH), bool))
    error = np.abs(straight.resampled(image) - scene(pixel_rays(WIDTH, HEIGHT, 60.0)))[good]
    assert good.mean() > 0.9
    assert error.max() < 2 * BOUND  # the coefficients stretch the image by up to 1.3, and 1.3² < 2


@pytest.mark.parametrize("maps_to", ["pixel", "ray"])
def test_rays_beyond_a_fold_are_seen_by_no_pixel(maps_to):
    lens = Lens(fx=68.0, fy=68.0, cx=0.0, cy=0.0, k1=-0.3, maps_to=maps_to)
    x = np.array([0.1, 0.5, 2.0])  # it folds at r² = 1 / 0.9, where it shows 0.70
    seen = seen_at(lens, x, 0 * x)[0]
    assert np.isfinite(seen).tolist() == [True, True, False]


def test_a_window_in_the_middle_is_cut_out():
    window = (20, 15, 56, 42)
    found = Undistortion.of_window(None, (WIDTH, HEIGHT), FOV_DEG, window)
    image = scene(RAYS)[15:57, 20:76]
    np.testing.assert_allclose(found.resampled(image), image, atol=1e-5)  # 30 halvings of 149 degrees
    assert np.tan(np.radians(found.fov_deg) / 2) == pytest.approx(28 / 68.551, rel=1e-5)


@pytest.mark.parametrize("window", [(0, 0, 40, 30), (50, 30, 46, 42), (4, 20, 20, 40)])
def test_a_window_beside_the_middle_is_the_image_of_a_camera_that_is_turned_to_it(window):
    left, top, width, height = window
    found = Undistortion.of_window(None, (WIDTH, HEIGHT), FOV_DEG, window)
    cut = scene(RAYS)[top : top + height, left : left + width]
    x, y = ray_of(PINHOLE, left + (width - 1) / 2, top + (height - 1) / 2)
    forward = np.array([x, y, 1]) / np.sqrt(x**2 + y**2 + 1)
    right = np.cross([0, 1, 0], forward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])  # of the turned camera: its rows stay level
    rays = pixel_rays(width, height, found.fov_deg) @ axes
    assert found.good(np.ones((height, width), bool)).all()
    assert np.abs(found.resampled(cut) - scene(rays)).max() < BOUND
    # It touches the edge of the window: no larger image fits
    place = rays[..., :2] / rays[..., 2:] * 68.551 + np.array([47.5 - left, 35.5 - top])
    slack = np.minimum(place, np.array([width - 1, height - 1]) - place).min()
    assert 0 <= slack < 1e-3


def test_pixels_outside_of_the_window_are_not_dead(tmp_path):
    z = wall_image(SLANTED)
    z[:, :40] = 0
    z[50, 60] = 0
    changes = {"layout": "phasors", "horizontal_fov_deg": FOV_DEG}
    whole = sidecar_of(tmp_path, IMAGES, **changes)
    assert capture_of(raw_of(whole, raw=z), whole).facts.dead == pytest.approx(40 / 96, abs=1e-3)
    part = sidecar_of(tmp_path, IMAGES, **changes, window=[40, 10, 56, 60])
    facts = capture_of(raw_of(part, raw=z), part).facts
    assert (facts.dead, facts.sensor_size) == (pytest.approx(1 / (56 * 60)), (56, 60))


def wall_image(plane_per_m):
    cosine = RAYS @ plane_per_m
    slope = 4 * np.pi * np.array(FREQUENCIES_HZ) / 299_792_458.0
    return (cosine**3)[..., None] * np.exp(1j * slope / cosine[..., None])


def test_the_wall_of_a_window_is_where_the_turned_camera_has_it(tmp_path):
    plane = np.array([0.2, 0.05, 0.6])
    part = sidecar_of(tmp_path, IMAGES, layout="phasors", horizontal_fov_deg=FOV_DEG, window=[50, 8, 40, 40])
    capture = capture_of(raw_of(part, raw=wall_image(plane)), part)
    x, y = ray_of(PINHOLE, 69.5, 27.5)
    pan = np.arctan(x)
    rays = pixel_rays(40, 40, capture.facts.horizontal_fov_deg)
    view = ExpectedWall(FREQUENCIES_HZ, np.empty(0), rays, plane)
    forward = np.array([x, y, 1]) / np.sqrt(x**2 + y**2 + 1)
    right = np.array([np.cos(pan), 0, -np.sin(pan)])
    turned = np.stack([right, np.cross(forward, right), forward]) @ plane
    phases = np.angle(capture.phasor * np.exp(-1j * view.slope / (rays @ turned)[..., None]))
    # Second derivatives of slope / cosine, by tangents: below 4 slope; (|f_xx| + |f_yy|) / 8 in pixels
    assert np.abs(phases).max() < 8 * view.slope.max() / 8 / 68**2


@pytest.mark.parametrize("window", [(60, 0, 40, 40), (0, 70, 10, 3), (0, 0, 97, 10)])
def test_a_window_that_leaves_the_sensor_is_refused(tmp_path, window):
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors", window=list(window))
    with pytest.raises(CaptureError, match=r"does not fit images of 96x72: correct window"):
        raw_of(sidecar, raw=wall_image(SLANTED))


def test_rows_of_alternating_sign_are_counted_from_the_edges_of_the_sensor(tmp_path):
    z = wall_image(SLANTED)
    row = np.arange(HEIGHT)
    signs = (-1.0) ** np.minimum(row, HEIGHT - 1 - row)
    changes = {"layout": "phasors", "horizontal_fov_deg": FOV_DEG, "window": [3, 21, 50, 40]}
    plain = sidecar_of(tmp_path, IMAGES, **changes)
    expected = capture_of(raw_of(plain, raw=z), plain).phasor
    signed = sidecar_of(tmp_path, IMAGES, **changes, alternating_row_sign=True)
    found = capture_of(raw_of(signed, raw=z * signs[:, None, None]), signed).phasor
    np.testing.assert_allclose(found, expected, atol=1e-14)
