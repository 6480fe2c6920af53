"""Pixels that see several surfaces are divided into cells: areas and averages against closed forms."""

import numpy as np
import pytest

from render.options import COARSEST_EDGES, FINEST_EDGES
from render.transport.film.edge_pixels import divide_pixels
from render.transport.film.pixels import Grid

GRID = Grid(8, 6)
ALL = np.arange(48)
SMALLEST = 1 / 512  # side of the smallest cells, in pixels


def in_pixels(points):
    return points * (GRID.width, GRID.height)


def share_of(edges, pixel, inside):
    """Share of a pixel in a region, by the weights of its points."""
    mine = edges.pixel == pixel
    return edges.weights[mine] @ inside(in_pixels(edges.points[mine]))


def divided(inside, candidates=ALL, divisions=FINEST_EDGES):
    def surfaces(points):
        return inside(in_pixels(points)).astype(np.uint32) + 1

    return divide_pixels(GRID, candidates, surfaces, divisions)


def half_plane(angle, through=(3.4, 2.6)):
    normal = np.array([np.cos(angle), np.sin(angle)])
    return lambda points: (points - through) @ normal > 0


def area_of_half_plane(angle, column, row, through=(3.4, 2.6)):
    """Share of a pixel in the half plane, by clipping its square (Sutherland and Hodgman, 1974)."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    square = [np.array([column + x, row + y]) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    kept = []
    for a, b in zip(square, [*square[1:], square[0]], strict=True):
        da, db = (a - through) @ normal, (b - through) @ normal
        if da > 0:
            kept.append(a)
        if da * db < 0:
            kept.append(a + da / (da - db) * (b - a))
    if len(kept) < 3:
        return 0.0
    x, y = np.array(kept).T
    return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 1.1, 2.0, 5.5])
def test_a_straight_edge_divides_pixels_by_area(angle):
    inside = half_plane(angle)
    edges = divided(inside)
    found = np.array([share_of(edges, pixel, inside) for pixel in edges.pixels])
    exact = np.array([area_of_half_plane(angle, pixel % 8, pixel // 8) for pixel in edges.pixels])
    # 800 smallest cells, each known to about a tenth: 1e-5 (film/edge_pixels.py); three of these. An edge
    # along the cells, as that of an upright wall, must not have the same error in all of them.
    assert np.abs(found - exact).max() < 3e-5
    # An edge through the corners of pixels touches others, which have a share of 0 or 1.
    cut = {pixel for pixel in ALL if 1e-9 < area_of_half_plane(angle, pixel % 8, pixel // 8) < 1 - 1e-9}
    assert cut <= set(edges.pixels)
    assert len(edges.pixels) == len(cut) or angle == np.pi / 4
    np.testing.assert_array_equal(np.sort(np.concatenate([edges.pixels, edges.uniform])), ALL)


@pytest.mark.parametrize(
    ("divisions", "expected"), [(FINEST_EDGES, 1e-5), (6, 3e-5), (5, 8.7e-5), (COARSEST_EDGES, 2.4e-4)]
)
def test_the_error_of_a_straight_edge_is_what_its_cells_allow(divisions, expected):
    errors = []
    for angle in np.random.default_rng(2).uniform(0, 2 * np.pi, 12):
        inside = half_plane(angle)
        edges = divided(inside, divisions=divisions)
        for pixel in edges.pixels:
            exact = area_of_half_plane(angle, pixel % 8, pixel // 8)
            errors.append(share_of(edges, pixel, inside) - exact)
    assert len(errors) > 80
    assert np.sqrt(np.mean(np.square(errors))) < expected


@pytest.mark.parametrize("slope", [0, np.inf, 1, -1, 0.5, -2, 3])
def test_an_edge_along_a_lattice_of_cells_has_no_common_error(slope):
    angle = np.arctan(slope) + np.pi / 2
    for through in np.random.default_rng(4).uniform(2, 4, (4, 2)):
        inside = half_plane(angle, through)
        edges = divided(inside)
        for pixel in edges.pixels:
            exact = area_of_half_plane(angle, pixel % 8, pixel // 8, through)
            # Three of the standard deviations above, which the largest of 200 reaches without a common error.
            assert abs(share_of(edges, pixel, inside) - exact) < 3e-5


@pytest.mark.parametrize("corner", [(3.3, 2.6), (3.0001, 2.9999), (3.5, 2.5)])
def test_a_corner_has_its_area(corner):
    def inside(points):
        return (points > corner).all(axis=1)

    edges = divided(inside)
    x, y = corner
    # Each of the two edges is known to a quarter of a smallest cell.
    exact = (4 - x) * (3 - y)
    assert share_of(edges, 2 * 8 + 3, inside) == pytest.approx(exact, abs=0.5 * SMALLEST)


def test_a_sliver_that_reaches_through_a_cell_has_its_area():
    width = 0.3 / 512  # of a pixel: less than the smallest cell
    x, y = np.array([3.4, 2.6])

    def inside(points):
        return (np.abs(points[:, 0] - x) < width / 2) & (points[:, 1] > y)

    edges = divided(inside)
    found = share_of(edges, 2 * 8 + 3, inside)
    # It may fall between all nodes, or be counted as half a smallest cell.
    assert abs(found - width * 0.4) < SMALLEST / 2


@pytest.mark.parametrize("region", [half_plane(0.7), lambda p: np.hypot(*(p - (4, 3)).T) < 1.7])
def test_the_weights_of_a_pixel_sum_to_one_and_its_points_lie_in_it(region):
    edges = divided(region)
    total = np.zeros(48)
    np.add.at(total, edges.pixel, edges.weights)
    np.testing.assert_allclose(total[edges.pixels], 1, rtol=1e-12)
    assert np.all(total[edges.uniform] == 0)
    assert np.all(edges.weights > 0)
    corner = np.stack([edges.pixel % 8, edges.pixel // 8], axis=-1)
    off = in_pixels(edges.points) - corner
    assert off.min() > -1e-9
    assert off.max() < 1 + 1e-9


def test_a_smooth_function_is_averaged_to_the_error_of_the_edge():
    # A wave before an edge, 0 behind it; the reference integrates in closed form along x.
    def inside(points):
        return points[:, 0] + 0.4 * points[:, 1] < 4.4

    edges = divided(inside)
    pixel = 2 * 8 + 3  # x from 3 to 4, y from 2 to 3
    mine = edges.pixel == pixel
    at = in_pixels(edges.points[mine])
    found = edges.weights[mine] @ (np.exp(1j * at[:, 0] + at[:, 1]) * inside(at))
    y = 2 + (np.arange(20000) + 0.5) / 20000
    end = np.clip(4.4 - 0.4 * y, 3, 4)
    exact = np.mean((np.exp(1j * end) - np.exp(3j)) / 1j * np.exp(y))
    # Three standard deviations of the area above, times the largest value of the function.
    assert abs(found - exact) < 3e-5 * np.exp(3)


def test_without_edges_nothing_is_divided():
    edges = divided(lambda points: points[:, 0] > -1)
    assert not len(edges.pixels)
    assert not len(edges.points)
    np.testing.assert_array_equal(edges.uniform, ALL)
    nothing = divided(half_plane(0.3), np.zeros(0, np.int64))
    assert not len(nothing.pixels)
    assert not len(nothing.weights)


def test_other_candidates_do_not_change_a_pixel():
    inside = half_plane(0.3)
    whole = divided(inside)
    one = divided(inside, whole.pixels[:1])
    mine = whole.pixel == whole.pixels[0]
    order = np.lexsort(whole.points[mine].T), np.lexsort(one.points.T)
    np.testing.assert_array_equal(whole.points[mine][order[0]], one.points[order[1]])
