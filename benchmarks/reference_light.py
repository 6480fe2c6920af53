"""A reference for the hidden signal: many more lights, other random numbers, no lattice.

`render_efficiency.py` and `error_coverage.py` measure true errors against it. The reference is computed
at some pixels of an image only, at the nodes that `many-light` takes in these pixels.
"""

from dataclasses import dataclass, replace
from math import ceil, log2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.transport.film.pixels import Grid
from render.transport.lights.hidden_surface import read_hidden_surface
from render.transport.lights.light_pass import Lights, light_density
from render.transport.lights.run_statistics import relative_bound
from render.transport.many_light import LightWorkshop, hidden_rule
from render.transport.method import View
from render.transport.passes.direct_samples import seen_surfaces
from render.transport.passes.gather_pass import gather_runs

TIMES = 16  # as many lights as the image that is judged has
_RUNS = 8
_OTHER_SEEDS = 2**20  # added to the seed of the view; the benchmarks use smaller seeds


@dataclass(frozen=True)
class Reference:
    """The hidden signal at P pixels.

    Attributes
    ----------
    pixels : (P,) row-major indices.
    values : (P, F) phasors.
    lights : number of lights.
    error : the reference's own error, as `many-light` would report it.
    """

    pixels: NDArray[np.int64]
    values: NDArray[np.complex128]
    lights: int
    error: float

    def of(self, image: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(P, F) values of an image (H, W, F) at these pixels."""
        return image.reshape(-1, image.shape[-1])[self.pixels]

    def relative_errors(self, image: NDArray[np.complex128]) -> NDArray[np.float64]:
        """(F,) true error of a hidden image (H, W, F), relative to the hidden signal."""
        missed = np.linalg.norm(self.of(image) - self.values, axis=0)
        return missed / np.linalg.norm(self.values, axis=0)


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
    return Reference(pixels, by_run.mean(axis=0), len(made), float(relative_bound(by_run).max()))


def _lights(scene: Any, view: View, at_least: int) -> Lights:
    """Lights of eight runs. Points that no light reaches give no light, so more points may be needed."""
    surface = read_hidden_surface(scene)
    workshop = LightWorkshop(scene, surface, light_density(scene, surface, view.seed), view)
    count = 2 ** ceil(log2(at_least / _RUNS))
    while len(made := workshop.lights(count, _RUNS, 0)) < at_least:
        count *= 2
    return made
