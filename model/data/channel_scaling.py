"""Fitting the constants of the input channels to the training scenes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from itof import amplitude, residual_channels
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallView
from model.data.feed import rows_by_piece
from model.data.scene_walls import SceneWalls
from model.data.shards import Shards
from model.network.channels import IMAGES_AT_ONCE, ChannelError, InputSpec
from model.settings.input import AmplitudeDivisor, Channels, Reference

# Scenes that scale the channels. The standard deviation of n values has the standard error 1 / sqrt(2 n) of
# itself, and the pixels of a scene are more than one value: less than 1.6 %.
SCENES: Final = 2048


def fit_input_spec(
    channels: Channels,
    shards: Shards,
    rows: Sequence[int],
    frequencies_hz: Sequence[float] | None = None,
    amplitude_divisor: AmplitudeDivisor = "mean",
    reference: Reference = "geometry",
    view: WallView | None = None,
) -> InputSpec:
    """The input channels, scaled by the training scenes, or by `SCENES` of them; reads a piece at a time.

    Parameters
    ----------
    channels : set of channels.
    rows : rows of the training scenes.
    frequencies_hz : modulation frequencies of the input, Hz; None for all of the shards.
    amplitude_divisor : the amplitude channel is divided by the mean of the amplitude over all pixels of the
        training scenes, so that its mean is 1, or by its maximum over all of them, so that it lies in [0, 1]
        as in the paper. Scenes that are brighter than all training scenes exceed 1.
    reference : where the direct return of the residual channels comes from.
    view : camera and relay wall of the shards; only the reference ``self`` needs it.

    Raises
    ------
    ChannelError : there are no scenes, they hold no light or numbers that are too large, or a frequency was
        not rendered.
    ValueError : `reference` needs `view`.
    """
    if not rows:
        raise ChannelError(
            "the input channels are scaled by the training scenes, but there are no training scenes"
        )
    available = shards.manifest.frequencies_hz
    chosen = tuple(frequencies_hz) if frequencies_hz else available
    residuals = 2 * len(chosen) - 1 if "residual" in channels else 0
    no_scale = (1.0, 1.0) if "wall" in channels else None
    unscaled = InputSpec(
        *(channels, chosen, 1.0, (1.0,) * residuals, "measured", reference, no_scale),
        wall_alone="wall" in channels,
    )
    places = unscaled.places(available)
    direct = shards.reference[..., places]
    if unscaled.self_calibrates and view is None:
        raise ValueError(f"the reference {reference} needs the camera and the wall: give view")
    wall = view.expected_wall(direct, chosen) if view and unscaled.self_calibrates else None
    walls_of_scenes = SceneWalls.of_shards(view, shards, chosen) if view and wall else None
    amplitudes, brightest, means, squares = [], 0.0, [], []
    walls: list[tuple[float, float, float]] = []
    for some, phasors in _images(shards, _sample(rows) if amplitude_divisor == "mean" else rows):
        wall = walls_of_scenes.of(shards.fields_of_view_deg(some)) if walls_of_scenes else wall
        first = amplitude(phasors[..., places[0]])  # (n, H, W)
        amplitudes.extend(first.mean(axis=(1, 2)))
        brightest = max(brightest, float(first.max()))
        if unscaled.uses_residual:
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                seen = phasors[..., places]
                known = _reference(unscaled, seen, wall) if wall else direct
                known, inverse = unscaled.parted(known)
                residual = np.asarray(  # (n, 2F - 1, H, W)
                    residual_channels(seen, known, wall_alone=unscaled.wall_alone), np.float64
                )
                if wall and unscaled.shows_wall:
                    walls.extend(_wall_statistics(inverse[..., 0].real.astype(np.float64), wall))
                means.extend(residual.mean(axis=(2, 3)))
                squares.extend((residual**2).mean(axis=(2, 3)))
    if not np.isfinite([*amplitudes, brightest, *np.ravel(squares)]).all():
        raise ChannelError(
            f"the phasors.npy of {shards.folder} have numbers that are too large: delete that folder, and it "
            "is made again"
        )
    if not np.mean(amplitudes) > 0:
        raise ChannelError(f"the {len(rows)} training scenes hold no light: render them again")
    residual_scale: tuple[float, ...] = ()
    if unscaled.uses_residual:
        variance = np.mean(squares, axis=0) - np.mean(means, axis=0) ** 2  # (2F - 1,)
        # A constant channel carries no information, so its scale does not matter.
        residual_scale = tuple(float(np.sqrt(v)) if v > 0 else 1.0 for v in variance)
    if walls:
        wall_mean, wall_square, _ = np.mean(walls, axis=0).tolist()
        spread = max(wall_square - wall_mean**2, 0.0) ** 0.5 or 1.0
        farthest_m = max(shift_m for _, _, shift_m in walls)
        unscaled = replace(unscaled, wall_scale_per_m=(wall_mean, spread), largest_shift_m=farthest_m)
    mean = float(np.mean(amplitudes))
    if amplitude_divisor == "mean":
        return replace(unscaled, amplitude_scale=mean, residual_scale=residual_scale)
    return replace(
        unscaled,
        amplitude_scale=brightest,
        residual_scale=residual_scale,
        training_mean_amplitude=mean,
    )


def largest_shift_m(inputs: InputSpec, shards: Shards, rows: Sequence[int], view: WallView) -> float:
    """Largest distance of a wall that scenes show from the expected one, metres; for the channel of the wall.

    It is that of `SCENES` scenes at most. One scene in so many is farther, and by much less than the 2 cm
    beyond it that a prediction lets pass (`itof.wall.plausibility`).

    Parameters
    ----------
    inputs : input channels, whose other constants stay those of the training scenes that they come from.
    view : camera and expected relay wall of the shards.
    """
    places, frequencies_hz = inputs.places(shards.manifest.frequencies_hz), inputs.frequencies_hz
    expected = view.expected_wall(shards.reference[..., places], frequencies_hz)
    of_scenes = SceneWalls.of_shards(view, shards, frequencies_hz)
    shifts_m = [0.0]
    for some, phasors in _images(shards, _sample(rows)):
        wall = of_scenes.of(shards.fields_of_view_deg(some)) if of_scenes else expected
        _, inverse = inputs.parted(_reference(inputs, phasors[..., places], wall))
        statistics = _wall_statistics(inverse[..., 0].real.astype(np.float64), wall)
        shifts_m.extend(shift_m for _, _, shift_m in statistics)
    return max(shifts_m)


def _reference(inputs: InputSpec, seen: NDArray[np.generic], wall: ExpectedWall) -> NDArray[np.generic]:
    """`InputSpec.reference_for` images (n, H, W, F), by PyTorch, which is faster than numpy here."""
    found: NDArray[np.generic] = inputs.reference_for(
        torch.from_numpy(seen), wall.converted(torch.from_numpy)
    ).numpy()
    return found


def _wall_statistics(
    inverse_distance_per_m: NDArray[np.float64], wall: ExpectedWall
) -> Iterator[tuple[float, float, float]]:
    """Of the wall of each image (n, H, W), 1/m: mean, mean square, and its distance from the expected wall.

    The distance, metres, is the mean along the rays that meet both walls.
    """
    expected_m = np.broadcast_to(wall.radial_depth_m, inverse_distance_per_m.shape)
    for inverse, depth_m in zip(inverse_distance_per_m, expected_m, strict=True):
        ahead = (inverse > 0) & np.isfinite(depth_m)
        shift_m = np.abs(1 / inverse[ahead] - depth_m[ahead]).mean() if ahead.any() else 0.0
        yield float(inverse.mean()), float((inverse**2).mean()), float(shift_m)


def _sample(rows: Sequence[int]) -> list[int]:
    """At most `SCENES` of the rows, evenly spread."""
    count = min(len(rows), SCENES)
    return [rows[place * len(rows) // count] for place in range(count)]


def _images(shards: Shards, rows: Sequence[int]) -> Iterator[tuple[list[int], NDArray[np.complex64]]]:
    """Some rows at a time, with the (n, H, W, F) phasors of their scenes."""
    for piece in rows_by_piece(rows, shards.manifest.scenes_per_piece):
        block = shards.read(piece)
        for start in range(0, len(piece), IMAGES_AT_ONCE):
            some = piece[start : start + IMAGES_AT_ONCE]
            yield some, block.take(some).phasors
