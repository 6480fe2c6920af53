"""Interpolation from a lattice over the film: exact for cubics, of fourth order, and kept from bad nodes."""

import numpy as np
import pytest

from render.transport.film.lattice import Lattice, filled

LATTICE = Lattice(7, 5)
POINTS = np.random.default_rng(1).random((400, 2))


def cubic(points):
    """(P, 2) two polynomials of degree three in x and in y."""
    x, y = points.T
    return np.stack(
        [x**3 * y**3 - 2j * x * y**2 + 0.5, (1 - 3 * x + x**3) * (2 + y**3) + 1j * x**2 * y**3], axis=-1
    )


def wave(points):
    """(P, 1) a smooth function that is no polynomial."""
    x, y = points.T
    return np.exp(2j * x + 3j * y**2)[:, None] / (1 + x[:, None] + y[:, None])


@pytest.mark.parametrize("lattice", [LATTICE, Lattice(3, 3), Lattice(4, 31)], ids=str)
def test_polynomials_of_degree_three_are_interpolated_exactly(lattice):
    values = cubic(lattice.nodes)
    np.testing.assert_allclose(lattice.interpolated(values, POINTS), cubic(POINTS), atol=1e-12)


def test_the_values_at_the_nodes_are_kept():
    values = wave(LATTICE.nodes)
    np.testing.assert_allclose(LATTICE.interpolated(values, LATTICE.nodes), values, atol=1e-13)


def test_half_the_step_has_a_sixteenth_of_the_error():
    lattice, errors = Lattice(10, 8), []
    for _ in range(4):
        errors.append(np.abs(lattice.interpolated(wave(lattice.nodes), POINTS) - wave(POINTS)).max())
        lattice = lattice.halved()
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(rates[1:] > 3.5)  # towards 4; the points hit the worst place of a cell only by chance


def test_a_halved_lattice_has_all_old_nodes_in_their_order():
    finer = LATTICE.halved()
    assert finer.shape == (11, 15)
    np.testing.assert_array_equal(finer.nodes[finer.is_old()], LATTICE.nodes)
    assert finer.is_old().sum() == len(LATTICE.nodes)


def test_the_three_interpolations_agree():
    values = wave(LATTICE.nodes)
    x, y = POINTS[:9, 0], POINTS[:6, 1]
    grid = LATTICE.interpolated_grid(values, x, y)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(grid.reshape(-1, 1), LATTICE.interpolated(values, points), atol=1e-13)
    table = values.real.reshape(*LATTICE.shape, 1).astype(np.float32)
    taps, weights = LATTICE.taps(x)
    rows = LATTICE.down(LATTICE.spline_columns(table), y)
    four = rows[:, taps[:, None] + np.arange(4)]  # (Y, X, 4, 1)
    np.testing.assert_allclose((four * weights[:, :, None]).sum(axis=2), grid.real, atol=2e-6)  # float32


@pytest.mark.parametrize(
    ("bad", "far", "near"),
    [
        # Cells that touch the bad node and two more cells are left out.
        (
            (6, 8),
            [(0.2, 0.2), (0.9, 0.8), (8.1 / 16, 1.9 / 12)],
            [(8.1 / 16, 6.1 / 12), (5.1 / 16, 3.2 / 12)],
        ),
        ((0, 0), [(3.1 / 16, 0.0), (0.0, 3.1 / 12), (1.0, 1.0)], [(0.0, 0.0), (2.9 / 16, 2.9 / 12)]),
        ((12, 16), [(12.9 / 16, 1.0), (0.0, 0.0)], [(1.0, 1.0), (13.1 / 16, 9.1 / 12)]),
    ],
    ids=["middle", "first", "last"],
)
def test_points_near_an_invalid_node_are_not_interpolated(bad, far, near):
    lattice = Lattice(16, 12)
    valid = np.ones(lattice.shape, bool)
    valid[bad] = False
    assert lattice.covers(np.array(far), valid.ravel()).all()
    assert not lattice.covers(np.array(near), valid.ravel()).any()


def test_all_points_are_interpolated_where_all_nodes_are_valid_and_none_where_none_is():
    assert LATTICE.covers(POINTS, np.ones(len(LATTICE.nodes), bool)).all()
    assert not LATTICE.covers(POINTS, np.zeros(len(LATTICE.nodes), bool)).any()


def test_a_linear_function_is_continued_into_invalid_nodes():
    x, y = Lattice(16, 12).nodes.T
    plane = (2 - 3 * x + 1j * y).reshape(13, 17, 1)
    valid = np.ones((13, 17), bool)
    valid[:, :5] = False
    valid[8, 11] = False
    np.testing.assert_allclose(filled(np.where(valid[..., None], plane, 1e9), valid), plane, atol=1e-12)


@pytest.mark.parametrize("valid", [np.zeros((4, 6), bool), np.eye(4, 6, dtype=bool)], ids=["none", "some"])
def test_filled_values_are_finite(valid):
    values = np.where(valid[..., None], 2.0, np.nan)
    expected = 2.0 if valid.any() else 0.0
    np.testing.assert_allclose(filled(values, valid), expected)


def test_what_is_behind_an_invalid_region_changes_covered_points_by_little():
    # An edge of the wall through the film: the ratio exists on one side only.
    lattice = Lattice(40, 30)
    valid = lattice.nodes[:, 0] + 0.3 * lattice.nodes[:, 1] < 0.8
    table = filled(wave(lattice.nodes).reshape(*lattice.shape, 1), valid.reshape(lattice.shape))
    covered = lattice.covers(POINTS, valid)
    assert 100 < covered.sum() < 350
    between = lattice.interpolated(table.reshape(-1, 1), POINTS[covered])
    # Continued linearly, the values miss by h² |w''| near the edge. A spline forgets 0.27 of that per cell,
    # and two cells are left out: below 0.27² (1/40)² 20 = 1e-3.
    assert np.abs(between - wave(POINTS[covered])).max() < 1e-3
