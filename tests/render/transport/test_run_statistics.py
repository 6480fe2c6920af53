"""The bound of the error of a mean of runs, against Monte Carlo with known covariance."""

import numpy as np
import pytest

from render.transport.lights.run_statistics import CONFIDENCE, relative_bound

DRAWS = 2000


@pytest.mark.parametrize("runs", [8, 16])
@pytest.mark.parametrize("freedom", [1, 3, 20])
def test_the_true_error_is_below_the_bound_as_often_as_it_says(runs, freedom):
    rng = np.random.default_rng(freedom)
    points = 40
    basis = np.linalg.qr(rng.standard_normal((2 * points, freedom)))[0]  # orthonormal modes of the error
    truth = rng.standard_normal(points) + 1j * rng.standard_normal(points)
    amplitude = rng.standard_normal((DRAWS, runs, freedom)) * 0.05
    off = amplitude @ basis.T  # real numbers of a run
    z = truth + off[..., :points] + 1j * off[..., points:]
    bound = np.array([relative_bound(draw[..., None])[0] for draw in z])
    mean = z.mean(axis=1)
    true = np.linalg.norm(mean - truth, axis=1) / np.linalg.norm(mean, axis=1)
    # Chance: at most sqrt(0.95 * 0.05 / 2000) = 0.5 %; this is two of these below the confidence.
    assert np.mean(true <= bound) >= CONFIDENCE - 0.01
    # It is no empty promise: for one degree of freedom and 8 runs, the root of Fisher's quantile is 2.84. The
    # mean of 2000 squares is known to 3 %.
    assert np.sqrt(np.mean(bound**2) / np.mean(true**2)) < 3.0


def test_modes_of_unequal_size_keep_the_bound():
    # Few lights have a few large common modes and many small ones.
    rng = np.random.default_rng(5)
    size = 0.6 ** np.arange(24)
    truth = np.ones(12, complex)
    off = rng.standard_normal((DRAWS, 8, 24)) * size * 0.02
    z = truth + off[..., :12] + 1j * off[..., 12:]
    bound = np.array([relative_bound(draw[..., None])[0] for draw in z])
    mean = z.mean(axis=1)
    true = np.linalg.norm(mean - truth, axis=1) / np.linalg.norm(mean, axis=1)
    assert np.mean(true <= bound) >= CONFIDENCE - 0.01


def test_frequencies_are_judged_one_by_one_and_a_signal_of_zero_has_no_error():
    rng = np.random.default_rng(0)
    z = 1 + 0.1 * rng.standard_normal((8, 30, 3)) * (1, 2, 0)
    z[..., 2] = 0
    one, two, none = relative_bound(z)
    assert 1.5 < two / one < 2.7
    assert none == 0
    np.testing.assert_allclose(relative_bound(7 * z), relative_bound(z))  # relative
    np.testing.assert_allclose(relative_bound(z[..., ::-1]), relative_bound(z)[::-1])


def test_equal_runs_have_no_error():
    assert relative_bound(np.ones((8, 5, 1), complex)) == [0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, complex(0, np.nan)])
def test_a_value_that_is_not_finite_is_refused(bad):
    z = np.ones((8, 5, 2), complex)
    z[3, 2, 1] = bad
    with pytest.raises(ValueError, match="not finite"):
        relative_bound(z)
