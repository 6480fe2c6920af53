"""Pixels that the projector lights in part: its image, a dot or the shadow of the middle wall ends there.

A flash at the camera has no such edges: it lights all that the camera sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log2
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.transport.film.edge_pixels import EdgePixels, divide_pixels
from render.transport.film.pixels import Grid
from render.transport.passes.direct_samples import DirectSamples, sample_direct

if TYPE_CHECKING:
    import mitsuba as mi

_FEWEST_CELLS, _MOST_CELLS = 4, 64  # of a pixel, along x and y, before any division
_AT_ONCE = 2**19  # cells, with nine points each
_APART = 1e-6  # metres
_INSIDE = 1e-6  # of the projector's image


@dataclass(frozen=True)
class LitPixels:
    """The pixels that are lit in part, with their cells, and the direct return there."""

    nodes: EdgePixels
    samples: DirectSamples

    def joined(self, edges: EdgePixels, samples: DirectSamples) -> tuple[EdgePixels, DirectSamples]:
        """These pixels, and those of `edges`, with `samples` there, that are none of these."""
        kept = np.flatnonzero(~np.isin(edges.pixel, self.nodes.pixels))
        some = EdgePixels(
            *(edges.pixels, edges.points[kept], edges.weights[kept], edges.pixel[kept], edges.uniform)
        )
        return _joined([some, self.nodes]), DirectSamples.joined([samples.at(kept), self.samples])


def lit_pixels(scene: mi.Scene, grid: Grid, seed: int, divisions: int) -> LitPixels | None:
    """None if one projector at the camera lights the whole image evenly, or other emitters light it.

    Cells are so small at first that every dot of the projector's image holds the corner or the middle of one.

    Parameters
    ----------
    divisions : how often cells with an edge are divided into four.
    """
    emitters = scene.emitters()
    if len(emitters) != 1 or emitters[0].class_name() != "Projector":
        return None
    image, at = _image(scene, grid)
    place, eye = (
        np.array(each.world_transform().matrix)[:3, 3].ravel() for each in (emitters[0], scene.sensors()[0])
    )
    if np.isnan(at).all():
        return None
    covers = np.nanmin(at) >= -_INSIDE and np.nanmax(at) <= 1 + _INSIDE
    if np.linalg.norm(place - eye) < _APART and image.min() == image.max() and covers:
        return None
    jumps = [np.abs(np.diff(at, axis=axis)).ravel() for axis in (0, 1)]
    steps = np.nanmax(np.concatenate([*jumps, [0.0]]))  # of a pixel, over the image
    cells = 2 ** ceil(log2(max(_FEWEST_CELLS, min(_MOST_CELLS, steps * max(image.shape) / 2))))

    def lit(points: NDArray[np.float64]) -> NDArray[np.uint32]:
        samples = sample_direct(scene, points, seed)
        return samples.surface * (samples.radiance > 0)

    # A finer start needs fewer divisions for cells of the same size.
    fewer = max(0, divisions - int(log2(cells // _FEWEST_CELLS)))
    every = np.arange(grid.width * grid.height)
    blocks = np.array_split(every, ceil(len(every) * cells**2 / _AT_ONCE))
    nodes = _joined([divide_pixels(grid, block, lit, fewer, first_cells=cells) for block in blocks])
    return LitPixels(nodes, sample_direct(scene, nodes.points, seed))


def _joined(parts: Sequence[EdgePixels]) -> EdgePixels:
    pixels = np.unique(np.concatenate([part.pixels for part in parts]))
    names = ("points", "weights", "pixel", "uniform")
    return EdgePixels(pixels, *(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _image(scene: mi.Scene, grid: Grid) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """The projector's image (H, W), and where in it (h, w, 2) the corners of the camera's pixels are.

    NaN where a corner shows nothing.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, rays

    emitter = scene.emitters()[0]
    sides = [np.linspace(0, 1, count + 1) for count in (grid.width, grid.height)]
    x, y = (arrays.upload(each.ravel()) for each in np.meshgrid(*sides))
    si = rays.camera_hits(scene, x, y)
    sample, _ = emitter.sample_direction(si, mi.Point2f(0.5))
    dr.eval(sample.uv, si.t)
    image = np.array(mi.traverse(emitter)["irradiance.data"])
    at = np.where(np.isfinite(np.array(si.t)), np.array(sample.uv), np.nan)
    return image[..., 0], at.T.reshape(grid.height + 1, grid.width + 1, 2).astype(float)
