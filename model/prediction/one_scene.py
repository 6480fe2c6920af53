"""Whether all parts of an image hold the light of one scene: its frequencies, and its halves.

The hidden light of a scene is a sum over its surfaces with weights that are not negative, the same at all
frequencies and in all pixels: in every pixel, the phasors are the Fourier transform of a measure of path
lengths that is nowhere negative. Patches on a lattice about the predicted surface, which face the wall, stand
for the surfaces. Nonnegative least squares finds their weights, beside the plane of the wall and the phase
offsets, which the self-calibration takes from the light. Of the light of one scene, they leave about 0.1 % of
the energy. If a part comes from another scene, no weights explain the whole, although they explain the rest:

    at frequency f:    gain = R(all) / R(without f),    for three frequencies or more
    in half of it:     gain = R(all) / (R(one half) + R(other half))

R is the energy that is left. Noise leaves gains of (2F - 1) / (2F - 3) and 1, and errors that all parts share
leave little more. Scenes that differ by less than what the patches leave are not told apart: of 360 mixtures
of scenes of the preset judge (seed 101), both of the frequencies of one pair.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from disk.frequency_text import megahertz
from itof import DepthMap
from itof.arrays import Bools, Floats, Phasors
from itof.light import phase_per_metre
from itof.wall.expected_wall import ExpectedWall
from model.prediction.nonnegative import nonnegative_weights
from model.prediction.surface_light import mirrored, ways

_SPACING_M: Final = 0.2  # of the patches, at least
_REACH_M: Final = 0.5  # from the predicted surface; predictions are off by less
_OFF_WALL_M: Final = 0.15
_PATCHES, _BOX, _SHOWN = 300, 20_000, 300  # at most: patches, lattice points, pixels of the prediction
_LIT, _BLOCKS = 80, 200  # pixels, about, that light the patches; blocks of pixels that see them
# What is left for other reasons: of the energy, and of the direct return of a rough wall.
_SHARE_LEFT: Final = 5e-5
_LIGHT_LEFT: Final = 5e-6
# Gains that are told: at the lowest frequency, because more surfaces explain the narrow band of the others,
# and elsewhere. One and a half times the largest of 120 scenes of the preset judge, seed 101, which have bent
# sheets or walls with gloss.
_LOWEST_GAIN: Final = 18.0
_GAIN: Final = 7.0


@dataclass(frozen=True)
class _Problem:
    """Light of B blocks of pixels, and what may explain it.

    Attributes
    ----------
    light : (C, B) residual channels times brightness; 0 in blocks that are not used.
    free : (C, B, 3 + F) change by the wall's plane and by the phase offsets.
    patches : (C, B, P) light of each patch.
    columns : of the blocks.
    """

    light: Floats
    free: Floats
    patches: Floats
    columns: int

    def left(self, channels: Floats | None = None, blocks: Bools | None = None) -> float:
        """Energy that the best weights leave, of combinations (D, C) of channels, in some (B,) blocks."""
        mix = np.eye(len(self.light)) if channels is None else channels
        some = slice(None) if blocks is None else blocks
        light, free, patches = (
            np.tensordot(mix, each[:, some], axes=1) for each in (self.light, self.free, self.patches)
        )
        values, patches = light.reshape(-1), patches.reshape(len(mix) * light.shape[1], -1)
        basis = np.linalg.qr(_scaled(free.reshape(len(values), -1)))[0]
        values = values - basis @ (basis.T @ values)
        patches = _scaled(patches - basis @ (basis.T @ patches))
        rest = values - patches @ nonnegative_weights(patches, values)
        return float(rest @ rest)


def other_scene(light: Floats, direct: Phasors, wall: ExpectedWall, prediction: DepthMap) -> str:
    """Which part of an image holds light of another scene than the rest, in words; empty if none does.

    Parameters
    ----------
    light : (2F - 1, H, W) residual channels times brightness, relative to the mean direct return; 0 in pixels
        that are not used.
    direct : (H, W, F) direct return, as bright as the measurement.
    wall : the relay wall where it is.
    """
    problem = _problem(light, direct, wall, prediction)
    if problem is None:
        return ""
    floor = _SHARE_LEFT * float((problem.light**2).sum()) + _LIGHT_LEFT**2 * problem.light.size
    gains = dict(_gains(problem, wall.frequencies_hz, floor))
    words = max(gains, key=lambda each: gains[each])
    return words if gains[words] > 1 else ""


def _gains(problem: _Problem, frequencies_hz: tuple[float, ...], floor: float) -> Iterator[tuple[str, float]]:
    count = len(frequencies_hz)
    whole, number = problem.left(), problem.light.shape[1]
    for place, frequency_hz in enumerate(frequencies_hz if count > 2 else ()):
        words = f"the light at {megahertz(frequency_hz)} is not that of the scene at the other frequencies"
        most = _LOWEST_GAIN if frequency_hz == min(frequencies_hz) else _GAIN
        yield words, whole / (problem.left(_without(place, count)) + floor) / most
    row, column = np.divmod(np.arange(number), problem.columns)
    halves = {"left and the right": column < problem.columns // 2, "upper and the lower": row < row[-1] / 2}
    for name, half in halves.items():
        apart = problem.left(blocks=half) + problem.left(blocks=~half)
        yield f"no scene has the light of the {name} half of the image", whole / (apart + floor) / _GAIN


def _without(place: int, count: int) -> Floats:
    """(2F - 3, 2F - 1) residual channels of the other frequencies, of the residual channels of all."""
    real = np.eye(count)[1:] - np.eye(count)[0]  # (F - 1, F) as the channels are
    kept = np.delete(np.arange(count), place)
    wanted = np.eye(count)[kept[1:]] - np.eye(count)[kept[0]]  # (F - 2, F)
    imaginary = np.eye(count, 2 * count - 1)[kept]
    of_real = np.linalg.lstsq(real.T, wanted.T, rcond=None)[0].T  # (F - 2, F - 1)
    return np.concatenate([imaginary, np.pad(of_real, ((0, 0), (count, 0)))])


def _problem(light: Floats, direct: Phasors, wall: ExpectedWall, prediction: DepthMap) -> _Problem | None:
    """None if the prediction shows nothing, or too few pixels are used."""
    height, width, count = direct.shape
    step = max(1, math.isqrt(height * width // _BLOCKS))
    rows, columns = height // step, width // step
    points = _lattice(prediction, wall)

    def in_blocks(values: Floats) -> Floats:
        """(..., B, step²)"""
        whole = values[..., : rows * step, : columns * step]
        parted = whole.reshape(*values.shape[:-2], rows, step, columns, step).swapaxes(-2, -3)
        return parted.reshape(*values.shape[:-2], rows * columns, step**2)

    used = in_blocks((light != 0).all(axis=0) & wall.meets).all(axis=-1)
    if not len(points) or not used.any():
        return None
    middle = (slice(step // 2, rows * step, step), slice(step // 2, columns * step, step))
    strength = in_blocks(np.abs(direct[..., 0])).mean(axis=-1) / np.abs(direct[..., 0]).mean()
    depth_m = np.where(used, np.asarray(wall.radial_depth_m)[middle].reshape(-1), 0.0)
    free = np.zeros((len(light), len(used), 3 + count))
    tangent = depth_m[:, None] ** 2 * np.asarray(wall.rays)[middle].reshape(-1, 3)  # (B, 3)
    for place, slope in enumerate(wall.slope):
        free[place, :, :3], free[place, :, 3 + place] = slope * tangent, 1.0
    patches = _patches(points, direct[middle].reshape(-1, count), wall, middle)
    return _Problem(
        in_blocks(light).mean(axis=-1) * used,
        free * (strength * used)[:, None],
        patches * used[:, None],
        columns,
    )


def _patches(points: Floats, direct: Phasors, wall: ExpectedWall, pixels: tuple[slice, slice]) -> Floats:
    """(2F - 1, B, P) channels of the light of patches (P, 3), beside a direct return (B, F)."""
    plane = np.asarray(wall.plane_per_m)
    normals = np.broadcast_to(plane / np.linalg.norm(plane), points.shape)  # towards the wall
    step = max(1, math.isqrt(wall.meets.size // _LIT))
    lit, lit_m = ways(points, normals, wall, (slice(step // 2, None, step),) * 2)
    seen, seen_m = ways(points, normals, wall, pixels)
    turned = []
    for place, slope in enumerate(phase_per_metre(wall.frequencies_hz)):
        at_patch = (lit * np.exp(1j * slope * lit_m)).sum(axis=0)
        turned.append(seen * np.exp(1j * (slope * seen_m - np.angle(direct[:, [place]]))) * at_patch)
    return np.stack([*(z.imag for z in turned), *(z.real - turned[0].real for z in turned[1:])])


def _lattice(prediction: DepthMap, wall: ExpectedWall) -> Floats:
    """(P, 3) points about a predicted surface, in front of the wall, camera axes."""
    plane, mask = np.asarray(wall.plane_per_m), prediction.mask
    shown = np.asarray(wall.rays)[mask] * np.asarray(prediction.radial_depth_m, np.float64)[mask][:, None]
    if not len(shown):
        return shown
    shown = shown[:: max(1, len(shown) // _SHOWN)]
    low, high = shown.min(axis=0) - _REACH_M, shown.max(axis=0) + _REACH_M
    spacing_m = max(_SPACING_M, float(np.prod(high - low) / _BOX) ** (1 / 3))
    while True:
        axes = [np.arange(one, other, spacing_m) for one, other in zip(low, high, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        points = points[points @ plane - 1 > _OFF_WALL_M * np.linalg.norm(plane)]
        away_m2 = ((points[:, None] - shown) ** 2).sum(axis=-1).min(axis=1, initial=np.inf)
        points = points[away_m2 < _REACH_M**2]
        if len(points) <= _PATCHES:
            return mirrored(points, plane)
        spacing_m *= 1.1


def _scaled(columns: Floats) -> Floats:
    """Columns (n, m) of length 1, without those that are 0."""
    size = np.linalg.norm(columns, axis=0)
    told = size > 1e-9 * size.max(initial=0.0)
    return columns[:, told] / size[told]
