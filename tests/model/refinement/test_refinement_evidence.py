"""How wrong a fit may be: what is known of the model's error from what is left of the light."""

import numpy as np
import pytest

from model.refinement.evidence import INDEPENDENT, USUAL_MISFIT, power_of_jumps, variance_of_model


@pytest.mark.parametrize("unknowns", [1, 6, 10])
def test_what_unknowns_take_of_a_models_error_is_put_back(unknowns):
    rng, count = np.random.default_rng(0), 4000
    error = USUAL_MISFIT / np.sqrt(INDEPENDENT) * rng.standard_normal((count, INDEPENDENT))
    left = np.sqrt((error[:, unknowns:] ** 2).sum(axis=1))  # each unknown takes one value
    stated = [variance_of_model(each, unknowns) for each in left]
    # The power that is left of n values scatters by sqrt(2 / n); the mean of all is within four deviations.
    rest = INDEPENDENT - unknowns
    scatter = np.sqrt(2 / rest) / np.sqrt(count)
    assert np.mean(stated) == pytest.approx(USUAL_MISFIT**2 / INDEPENDENT, rel=4 * scatter)


def test_a_fit_with_as_many_unknowns_as_values_states_a_finite_error():
    stated = variance_of_model(USUAL_MISFIT, 30)
    assert USUAL_MISFIT**2 / INDEPENDENT < stated < np.inf


def test_light_on_a_line_has_no_jumps_and_that_of_noise_has_its_power():
    rng = np.random.default_rng(1)
    middle, slope = rng.standard_normal(300), rng.standard_normal((7, 300))
    straight = middle + np.array([1.0, -1.0])[:, None] * slope[:, None]
    assert power_of_jumps(straight, middle) < 1e-20
    jumps = 0.1 * rng.standard_normal((8, 2, 300))
    # The middle is common to all sides: 2 of 3 parts of the power come from it, with 300 values.
    assert power_of_jumps(straight + jumps[:7], middle + 0.1 * rng.standard_normal(300)) == pytest.approx(
        300 * 0.1**2, rel=4 * np.sqrt(2 / 300)
    )
