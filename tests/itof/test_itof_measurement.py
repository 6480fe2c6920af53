"""Φ, phase, depth and unwrapping against closed forms of single returns."""

import numpy as np
import pytest

from itof import (
    SPEED_OF_LIGHT,
    MeasurementMatrix,
    combined_range_m,
    depth_from_phase,
    phase,
    phasor_of_return,
    phasors,
    unambiguous_range_m,
    unwrap_depth,
)

FREQUENCIES_HZ = (20e6, 50e6, 60e6)


def test_the_speed_of_light_is_the_exact_value_of_the_si():
    assert SPEED_OF_LIGHT == 299_792_458.0


def test_a_return_at_a_bin_centre_gives_its_phasor_exactly():
    transient = np.zeros((2, 3, 500), np.float32)
    transient[1, 2, 137] = 0.25
    z = phasors(transient, FREQUENCIES_HZ, 0.01, start_opl_m=1.0)
    opl_m = 1.0 + 137.5 * 0.01
    expected = 0.25 * np.exp(2j * np.pi * np.array(FREQUENCIES_HZ) * opl_m / SPEED_OF_LIGHT)
    np.testing.assert_allclose(z[1, 2], expected, rtol=1e-12)
    assert np.count_nonzero(z) == len(FREQUENCIES_HZ)


def test_rows_are_cosines_then_sines():
    matrix = MeasurementMatrix((20e6, 50e6), 4, 0.5)
    angle = 2 * np.pi * 50e6 * (0.5 * 2.5) / SPEED_OF_LIGHT  # third bin: centre at 1.25 m
    assert matrix.rows.shape == (4, 4)
    np.testing.assert_allclose(matrix.rows[[1, 3], 2], [np.cos(angle), np.sin(angle)], rtol=1e-12)


def test_a_tent_splat_between_two_bins_has_the_phase_of_the_return():
    # Linear interpolation errs by (k w)^2 / 8 of the amplitude at most: 2.0e-5 at 60 MHz and 1 cm.
    opl_m = 3.0037
    centre = opl_m / 0.01 - 0.5
    lower = int(centre)
    transient = np.zeros(1000)
    transient[lower], transient[lower + 1] = 1 - (centre - lower), centre - lower
    z = phasors(transient, FREQUENCIES_HZ, 0.01)
    exact = np.exp(2j * np.pi * np.array(FREQUENCIES_HZ) * opl_m / SPEED_OF_LIGHT)
    bound = (2 * np.pi * np.array(FREQUENCIES_HZ) / SPEED_OF_LIGHT * 0.01) ** 2 / 8
    assert np.all(np.abs(z - exact) <= bound * 1.001)


@pytest.mark.parametrize("frequency_hz", FREQUENCIES_HZ)
@pytest.mark.parametrize(
    ("splat", "edge", "share", "order"),
    [("tent", [0.5], 240, 2), ("quadratic", [1 / 48, 1 / 2, 47 / 48], 822, 3)],
)
def test_the_matrix_undoes_the_splat_of_a_box_pulse(frequency_hz, splat, edge, share, order):
    # Light spread evenly from bin centre 100 to 140: each bin gets 1, those around the ends get `edge`.
    # Tent: its phasor is the pulse's times x cot x = 1 - x^2/3 - x^4/45 with x = kw/2, and the transfer
    # function is sinc^2 x = 1 - x^2/3 + 2x^4/45: they differ by x^4/15 = (kw)^4 / 240, 1e-10 at 60 MHz.
    # Quadratic: aliases of the pulse leave sum_m (-1)^m (kw / 2πm)^4 over m != 0, 7/5760 = 1/822.9 of (kw)^4.
    width_m, first, last = 0.01, 100, 140
    transient = np.zeros(500)
    transient[first : last + 1] = 1
    reach = len(edge) // 2
    transient[first - reach : first + reach + 1] = edge
    transient[last - reach : last + reach + 1] = edge[::-1]
    k = 2 * np.pi * frequency_hz / SPEED_OF_LIGHT
    ends_m = (np.array([first, last]) + 0.5) * width_m
    exact = np.diff(np.exp(1j * k * ends_m))[0] / (1j * k * width_m)  # integral over the pulse, per bin
    error = {
        name: MeasurementMatrix((frequency_hz,), 500, width_m, splat=name).apply(transient)[0] / exact - 1
        for name in ("point", splat)
    }
    assert abs(error[splat]) < 1.01 * (k * width_m) ** 4 / share + 1e-13
    assert error["point"] == pytest.approx(-order * (k * width_m) ** 2 / 24, abs=(k * width_m) ** 4)


def test_streaming_over_row_blocks_equals_the_whole_cube():
    rng = np.random.default_rng(3)
    cube = rng.random((7, 5, 60), dtype=np.float32)
    matrix = MeasurementMatrix(FREQUENCIES_HZ, 60, 0.02)
    streamed = matrix.apply_streaming(iter([cube[:3], cube[3:4], cube[4:]]))
    np.testing.assert_allclose(streamed, matrix.apply(cube), rtol=1e-12)


@pytest.mark.parametrize("frequency_hz", FREQUENCIES_HZ)
def test_depth_of_a_single_return_survives_the_round_trip_up_to_the_unambiguous_range(frequency_hz):
    limit_m = float(unambiguous_range_m(frequency_hz))
    depth_m = np.linspace(0.0, limit_m, 101)[:-1]
    back = depth_from_phase(phase(phasor_of_return(depth_m, frequency_hz)), frequency_hz)
    np.testing.assert_allclose(back, depth_m, atol=1e-9)


def test_the_unambiguous_range_at_20_mhz_is_7_49_m():
    assert float(unambiguous_range_m(20e6)) == pytest.approx(299_792_458 / 40e6, rel=1e-12)


def test_a_return_past_the_unambiguous_range_wraps_by_exactly_that_range():
    limit_m = float(unambiguous_range_m(50e6))
    wrapped = depth_from_phase(phase(phasor_of_return(limit_m + 0.7, 50e6)), 50e6)
    assert float(wrapped) == pytest.approx(0.7, abs=1e-9)


def test_phase_lies_in_zero_to_two_pi_even_just_below_zero():
    values = phase(np.array([1 - 1e-20j, 1 - 1e-3j, -1.0, 1.0, 0.0]))
    assert np.all((values >= 0) & (values < 2 * np.pi))
    np.testing.assert_allclose(values[1:4], [2 * np.pi - 1e-3, np.pi, 0], atol=1e-6)


def test_three_frequencies_unwrap_to_14_99_m():
    assert combined_range_m(FREQUENCIES_HZ) == pytest.approx(299_792_458 / 20e6, rel=1e-12)  # of 10 MHz
    depth_m = np.linspace(0.01, 14.9, 331).reshape(331, 1)
    phi = phase(phasor_of_return(depth_m[..., None], np.array(FREQUENCIES_HZ)))
    np.testing.assert_allclose(unwrap_depth(phi, FREQUENCIES_HZ), depth_m, atol=1e-8)


def test_nearly_coprime_frequencies_are_searched_to_100_m_only():
    frequencies_hz = (50e6, 50e6 + 1)  # repeat together after 150 000 km: 5e7 turns would take minutes
    depth_m = np.array([0.5, 2.5])
    phi = phase(phasor_of_return(depth_m[:, None], np.array(frequencies_hz)))
    phi[:, 1] += 1e-3  # noise, which a search without a limit would explain by a far depth
    found_m = unwrap_depth(phi, frequencies_hz)
    assert np.all(found_m < 101)
    assert combined_range_m(frequencies_hz) > 1e8


def test_unwrapping_averages_phase_noise_with_the_weight_of_each_frequency():
    # Least squares with slopes s_f has the standard deviation sigma / |s|, better than any single one.
    rng = np.random.default_rng(5)
    sigma, depth_m = 0.01, 4.2
    slopes = 4 * np.pi * np.array(FREQUENCIES_HZ) / SPEED_OF_LIGHT
    noisy = np.mod(slopes * depth_m + sigma * rng.standard_normal((20_000, 3)), 2 * np.pi)
    error = unwrap_depth(noisy, FREQUENCIES_HZ) - depth_m
    expected = sigma / np.linalg.norm(slopes)
    assert np.std(error) == pytest.approx(expected, rel=5 / np.sqrt(2 * 20_000))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((15e9,), 10, 0.01), "cannot resolve 15000 MHz"),
        (((), 10, 0.01), "at least one"),
        (((-1.0,), 10, 0.01), "positive"),
        (((20e6,), 0, 0.01), "0 bins"),
        (((20e6,), 10, float("nan")), "nan"),
    ],
)
def test_a_measurement_that_cannot_be_is_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        MeasurementMatrix(*arguments)


def test_a_transient_with_another_number_of_bins_is_refused():
    with pytest.raises(ValueError, match="expected 10 time bins"):
        MeasurementMatrix((20e6,), 10, 0.01).apply(np.zeros((3, 4, 11)))
