"""A reference for the hidden signal: many more lights, other random numbers, no lattice.

`error_coverage.py` measures true errors against it. It is computed at some pixels of an image only: at the
nodes that `many-light` takes in these pixels, or, in random corners, at nodes of its own.
"""

from dataclasses import dataclass, replace
from math import ceil, log2
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from render.transport.film.pixels import Grid, group_sums
from render.transport.lights.hidden_surface import read_hidden_surface
from render.transport.lights.light_pass import Lights, light_density
from render.transport.lights.run_statistics import relative_bound
from render.transport.many_light import LightWorkshop, hidden_rule
from render.transport.method import View
from render.transport.passes.direct_samples import direct_phasors_of, sample_direct, seen_surfaces
from render.transport.passes.gather_pass import gather_runs
from scenegen import Scene

TIMES = 16  # as many lights as the image that is judged has
_RUNS = 8
_DIRECT = 16  # nodes along each side of whole pixels, and of the parts of the others
_HIDDEN, _NEAR, _PIXELS_NEAR = 3, 8, 2  # the same; beside the edge of a wall its shadow needs more
_OTHER_SEEDS = 2**20  # added to the seed of the view; the benchmarks use smaller seeds


@dataclass(frozen=True)
class Reference:
    """The hidden signal at P pixels, or all light.

    Attributes
    ----------
    pixels : (P,) row-major indices.
    values : (P, F) phasors.
    hidden : (P, F) phasors of the hidden part of `values`.
    counts : (P,) for how many pixels of the image each stands.
    lights : number of lights.
    error : the reference's own error, as `many-light` would report it.
    """

    pixels: NDArray[np.int64]
    values: NDArray[np.complex128]
    hidden: NDArray[np.complex128]
    counts: NDArray[np.float64]
    lights: int
    error: float

    def of(self, image: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(P, F) values of an image (H, W, F) at these pixels."""
        return image.reshape(-1, image.shape[-1])[self.pixels]

    def relative_errors(self, image: NDArray[np.complex128]) -> NDArray[np.float64]:
        """(F,) true error of an image (H, W, F), relative to the hidden signal."""
        share = np.sqrt(self.counts)[:, None]
        missed = np.linalg.norm(share * (self.of(image) - self.values), axis=0)
        return missed / np.linalg.norm(share * self.hidden, axis=0)


def reference(scene: Any, view: View, lights: int, most_pixels: int) -> Reference:
    """The hidden signal by at least 16 times as many lights, with other seeds.

    Parameters
    ----------
    view : of the image that is judged.
    lights : number of lights of that image.
    most_pixels : an image with more pixels is judged at as many, which are drawn at random.
    """
    grid = Grid(view.layout.width, view.layout.height)
    pixels = np.arange(grid.width * grid.height)
    if len(pixels) > most_pixels:
        pixels = np.sort(np.random.default_rng(0).choice(pixels, most_pixels, replace=False))
    rule = hidden_rule(grid.width)
    points = grid.points(pixels, rule.pixel_nodes).reshape(-1, 2)
    if len(np.unique(seen_surfaces(scene, points))) != 1:
        raise SystemExit("some pixels see the edge of a surface, and this reference does not divide pixels")
    made = _lights(scene, replace(view, seed=view.seed + _OTHER_SEEDS), TIMES * lights)
    by_run = gather_runs(scene, points, view.frequencies_hz, made)
    by_run = np.einsum("rpnf,n->rpf", by_run.reshape(_RUNS, len(pixels), rule.count, -1), rule.pixel_weights)
    hidden, error = by_run.mean(axis=0), float(relative_bound(by_run).max())
    return Reference(pixels, hidden, hidden, np.ones(len(pixels)), len(made), error)


def corner_reference(corner: Scene, scene: Any, view: View, lights: int, most_pixels: int) -> Reference:
    """All light of a random corner: the free parts of pixels are polygons, and all have more nodes.

    Parameters
    ----------
    corner : the data of `scene`.
    most_pixels : drawn at random; all pixels with an edge and beside one are compared as well.
    """
    from batch_quadrature import free_nodes

    size = (view.layout.width, view.layout.height)
    *_, pixel, edges = free_nodes(corner, *size, 1, 1)
    is_near = np.zeros(size[::-1], bool)
    is_near.flat[edges] = True
    near = np.intersect1d(np.flatnonzero(maximum_filter(is_near, 2 * _PIXELS_NEAR + 1)), pixel)
    whole = np.setdiff1d(pixel, near)
    some = np.sort(np.random.default_rng(0).permutation(whole)[:most_pixels])
    pixels = np.concatenate([near, some])
    counts = np.concatenate([np.ones(len(near)), np.full(len(some), len(whole) / max(len(some), 1))])
    points, weights, pixel, _ = free_nodes(corner, *size, _DIRECT, _DIRECT, pixels)
    z = direct_phasors_of(sample_direct(scene, points, view.seed), view.frequencies_hz) * weights[:, None]
    direct = group_sums(z, pixel, size[0] * size[1])[pixels]
    made = _lights(scene, replace(view, seed=view.seed + _OTHER_SEEDS), TIMES * lights)
    rules = ((near, _NEAR), (some, _HIDDEN))
    nodes = [free_nodes(corner, *size, n, n, some)[:3] for some, n in rules if len(some)]
    points, weights, pixel = (np.concatenate(each) for each in zip(*nodes, strict=True))
    by_run = gather_runs(scene, points, view.frequencies_hz, made) * weights[:, None]
    by_run = np.stack([group_sums(one, pixel, size[0] * size[1])[pixels] for one in by_run])
    hidden, error = by_run.mean(axis=0), float(relative_bound(by_run).max())
    return Reference(pixels, direct + hidden, hidden, counts, len(made), error)


def _lights(scene: Any, view: View, at_least: int) -> Lights:
    """Lights of eight runs. Points that no light reaches give no light, so more points may be needed."""
    surface = read_hidden_surface(scene)
    workshop = LightWorkshop(scene, surface, light_density(scene, surface, view.seed), view)
    count = 2 ** ceil(log2(at_least / _RUNS))
    while len(made := workshop.lights(count, _RUNS, 0)) < at_least:
        count *= 2
    return made
