"""Prediction on arrays: its reference, its units, and arrays that are refused."""

import numpy as np
import pytest
from pydantic import TypeAdapter

from itof import pixel_rays
from itof.wall.wall_view import WallView
from model.data.corner import wall_view
from model.prediction.predictor import load

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def predictor(seeing_run):
    return load(seeing_run, "cpu")


def test_the_view_of_the_wall_comes_back_exactly_from_json(closed_form_scenes, predictor):
    view = wall_view(closed_form_scenes)
    adapter = TypeAdapter(WallView)
    assert adapter.validate_json(adapter.dump_json(view)) == view
    assert predictor.config.geometry == view
    rng = np.random.default_rng(4)
    numbers = rng.standard_normal(18).tolist()
    odd = WallView(
        horizontal_fov_deg=59.99999999999999,
        camera_axes=tuple(tuple(numbers[i : i + 3]) for i in (0, 3, 6)),
        camera_location_m=tuple(numbers[9:12]),
        wall_point_m=tuple(numbers[12:15]),
        wall_normal=tuple(numbers[15:]),
    )
    assert adapter.validate_json(adapter.dump_json(odd)) == odd


def test_a_predictor_says_in_two_lines_what_it_is_for(predictor):
    lines = repr(predictor).split("\n")
    height, width = predictor.reference.shape[:2]
    assert lines[0] == f"Predictor for {width} x {height} pixels, 20, 50, 60 MHz, 60 degrees"
    assert len(lines) == 2
    assert predictor._repr_html_().count("<li>") == 2


def test_the_reference_of_a_run_is_that_of_the_shards(predictor, shards):
    np.testing.assert_array_equal(predictor.reference, shards.reference)


def test_a_prediction_needs_no_reference_and_images_may_come_one_by_one(predictor, phasors, shards):
    given = predictor.predict(phasors, shards.reference)
    many, one = predictor.predict(phasors), predictor.predict(phasors[1])
    np.testing.assert_array_equal(many.radial_depth_m, given.radial_depth_m)
    np.testing.assert_array_equal(many.depth, many.radial_depth_m)
    assert many.mask.any(axis=(1, 2)).all()
    assert np.count_nonzero(many.radial_depth_m[~many.mask]) == 0
    assert many.radial_depth_m.shape == phasors.shape[:3]
    assert one.radial_depth_m.shape == phasors.shape[1:3]
    np.testing.assert_allclose(one.phasor, many.phasor[1], atol=1e-5)


def test_z_depth_is_radial_depth_times_the_rays_cosine(predictor, phasors):
    one = predictor.predict(phasors[0])
    height, width = one.mask.shape
    cosine = pixel_rays(width, height, 60.0)[..., 2]
    np.testing.assert_allclose(one.z_depth_m(60.0), one.radial_depth_m * cosine, rtol=1e-12)


def test_a_thousandfold_measurement_has_the_same_depth_when_rescaled(predictor, phasors):
    own = predictor.predict(phasors, rescale=True)
    scaled = predictor.predict(1000 * phasors, 7 * predictor.reference, rescale=True)
    np.testing.assert_array_equal(scaled.mask, own.mask)
    # float32 rounds the channels by some 1e-5 of their unit, and the network carries that to metres.
    np.testing.assert_allclose(scaled.radial_depth_m, own.radial_depth_m, atol=1e-4)
    trusted = predictor.predict(1000 * phasors)
    assert np.abs(trusted.phasor - own.phasor).max() > 1


def test_arrays_that_are_not_phasors_are_refused(predictor, phasors):
    for spoilt, words in (
        (phasors.real, "complex phasors, got float32"),
        (np.concatenate([phasors.real, phasors.imag], axis=-1), r"got \(3, 14, 24, 6\)"),
        (phasors[:, :, :-1], r"expected phasors of shape \(14, 24, 3\)"),
        (phasors[..., :2], r"got \(3, 14, 24, 2\)"),
        (phasors[:0], r"got \(0, 14, 24, 3\)"),
        (phasors[0, 0], r"expected phasors of shape \(H, W, F\) or"),
        (phasors * np.inf, "NaN or infinite"),
        (phasors * np.nan, "NaN or infinite"),
        (phasors.astype(np.complex128) * 1e200, "too large for the network"),
    ):
        with pytest.raises(ValueError, match=words):
            predictor.predict(spoilt)
    with pytest.raises(ValueError, match=r"reference of shape \(14, 24, 3\), got \(14, 24, 2\)"):
        predictor.predict(phasors, predictor.reference[..., :2])
    with pytest.raises(ValueError, match="the reference holds NaN"):
        predictor.predict(phasors, predictor.reference * np.nan)
    dark = np.stack([phasors[0], 0 * phasors[0]])
    with pytest.raises(ValueError, match="image 1 of 2 holds no light"):
        predictor.predict(dark, rescale=True)
