"""Interpolated transients of the hidden signal against exact ones of the same lights."""

import many_light_scenes as corner
import numpy as np
import pytest
from many_light_scenes import FREQUENCIES_HZ, SMALL, ball, box, expose, relative, rough_plastic
from odd_corners import OddCorner

from itof import MeasurementMatrix, TransientLayout
from render.transport.passes import hidden_curves, transient_pass
from render.transport.passes.transient_pass import transient_rows

LAYOUT = TransientLayout(24, 18, 1400, 0.01, 0.0)
PHI = MeasurementMatrix(FREQUENCIES_HZ, LAYOUT.bin_count, LAYOUT.bin_width_m, splat="quadratic")


@pytest.fixture
def hidden_bins(monkeypatch):
    """exposure, whether to interpolate -> (H, W, T) the hidden part of its transient."""

    def bins(exposure, interpolate=True):
        from render.transport.many_light import hidden_rule

        with monkeypatch.context() as patch:
            if not interpolate:
                patch.setattr(transient_pass, "make_curves", lambda *_: None)
            layout = exposure.view.layout
            rest = exposure.view, exposure._grid, hidden_rule(layout.width), exposure.direct_image
            full, empty = (
                np.concatenate(
                    list(transient_rows(exposure.scene, *rest, field).of_all_bins(layout.bin_count))
                ).astype(float)
                for field in (exposure.field, None)
            )
        return full - empty

    return bins


def different(one, other):
    """Sum of absolute differences over pixels and bins, relative to the light."""
    return np.abs(one - other).sum() / other.sum()


def check(hidden_bins, scene, variant, phi_error=0.002):
    exposure = expose(scene, variant, lights=512, layout=LAYOUT)
    fast, exact = hidden_bins(exposure), hidden_bins(exposure, interpolate=False)
    assert not np.array_equal(fast, exact)
    # Time and place: a lattice cell is 6 cm of the wall (passes/hidden_curves.py), and single lights show.
    assert different(fast, exact) < 0.03
    assert fast.sum() == pytest.approx(exact.sum(), rel=1e-3)
    image = [bins.sum(axis=2)[..., None] for bins in (fast, exact)]
    # A spline between nodes rings where the shadow of a single light ends. Composites have most shadows.
    assert relative(*image) < phi_error
    assert np.all(relative(PHI.apply(fast), PHI.apply(exact)) < phi_error)
    return fast, exact


def test_interpolated_curves_have_the_time_and_the_phasors_of_exact_ones(variant, tmp_path, hidden_bins):
    check(hidden_bins, OddCorner((ball(),), wall_bsdf=rough_plastic(0.5)).load(tmp_path), variant)


@pytest.mark.long
@pytest.mark.parametrize(
    ("mesh", "roughness"),
    [
        pytest.param(box(), None, id="box"),
        pytest.param(box((0.002, 0.4, 0.4)), 0.3, id="foil"),
    ],
)
def test_curves_of_other_corners_are_as_exact(variant, tmp_path, hidden_bins, mesh, roughness):
    bsdf = corner.DIFFUSE if roughness is None else rough_plastic(roughness)
    check(hidden_bins, OddCorner((mesh,), wall_bsdf=bsdf).load(tmp_path), variant)


@pytest.mark.long
def test_curves_of_a_composite_err_less_than_its_lights(four_shapes, variant, hidden_bins):
    fast, exact = check(hidden_bins, four_shapes["composite"], variant, phi_error=0.003)
    other = hidden_bins(expose(four_shapes["composite"], variant, lights=512, seed=2, layout=LAYOUT))
    # Half of it adds an eighth to the error of the lights (in squares).
    assert different(fast, exact) < 0.5 * different(other, fast)


@pytest.mark.long
def test_curves_end_at_the_edge_of_the_middle_wall(variant, tmp_path, hidden_bins):
    scene = OddCorner((ball(),), wall_bsdf=rough_plastic(0.5), fov_deg=90).load(tmp_path)
    fast, exact = check(hidden_bins, scene, variant)
    dark = exact.sum(axis=2) == 0
    assert not fast[dark].any()


def test_bins_hold_few_digits_and_the_whole_signal(variant, tmp_path, hidden_bins, monkeypatch):
    exposure = expose(OddCorner((ball(),)).load(tmp_path), variant, lights=512, layout=LAYOUT)
    rounded = hidden_bins(exposure)
    monkeypatch.setattr(hidden_curves, "_QUANTUM", 2.0**-30)
    whole = hidden_bins(exposure)
    assert not np.array_equal(rounded, whole)
    # 300 bins of a third of the largest one are 100 of it. Each misses 2^-11 / 12^(1/2) of it at random, so
    # all miss 300^(1/2) times that, which is 2.4e-5 of 100.
    assert np.all(relative(PHI.apply(rounded), PHI.apply(whole)) < 1e-4)
    assert rounded.sum() == pytest.approx(whole.sum(), rel=1e-4)


def test_bins_have_the_noise_of_the_lights_also_for_small_errors(variant, tmp_path, hidden_bins, monkeypatch):
    scene = OddCorner((box(),)).load(tmp_path)
    some, others = (expose(scene, variant, lights=4096, seed=seed, layout=SMALL) for seed in (1, 2))
    bins, noisy = hidden_bins(some), hidden_bins(others)
    monkeypatch.setattr(transient_pass, "_ALL_PACKETS", 2**22)
    # A quarter of the difference of two seeds adds a 16th to it, in squares. Packets for larger errors: 0.4.
    assert different(bins, hidden_bins(some)) < 0.25 * different(bins, noisy)


def test_no_bin_is_negative_beyond_the_ringing_of_a_spline(variant, tmp_path, hidden_bins):
    fast = hidden_bins(expose(OddCorner((box(),)).load(tmp_path), variant, lights=64, layout=LAYOUT))
    # No closed form: a spline rings by up to 9 % of a step (Gibbs), and few bins are beside a step.
    assert -np.minimum(fast, 0).sum() < 0.01 * fast.sum()
