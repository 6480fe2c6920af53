"""Least squares with weights that are not negative: closed form, and the conditions of the minimum."""

import numpy as np
import pytest

from model.prediction.nonnegative import nonnegative_weights


def test_of_orthonormal_columns_each_weight_is_its_projection_or_zero():
    columns = np.linalg.qr(np.random.default_rng(1).standard_normal((9, 4)))[0]
    values = columns @ [3.0, -2.0, 0.5, -1e-3]
    np.testing.assert_allclose(nonnegative_weights(columns, values), [3, 0, 0.5, 0], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(("rows", "count"), [(5, 9), (70, 30), (10, 1), (10, 0)])
def test_weights_satisfy_the_conditions_of_kuhn_and_tucker(rows, count):
    """The slope is 0 where a weight is positive, and leads below 0 where it is 0."""
    rng = np.random.default_rng(2)
    columns = rng.random((rows, count)) + 1e-3
    columns /= np.linalg.norm(columns, axis=0)
    values = columns @ np.maximum(rng.standard_normal(count), 0) + 0.1 * rng.standard_normal(rows)
    weights = nonnegative_weights(columns, values)
    slope = columns.T @ (values - columns @ weights)
    assert (weights >= 0).all()
    assert np.abs(slope[weights > 0]).max(initial=0) < 1e-9
    assert slope.max(initial=0) < 1e-9
