"""Phasors of one frame after the other, and which sensor pixels can be used."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from disk.frequency_text import megahertz
from itof import phasor_of_return, radial_from_z
from itof.arrays import Complex, Numbers
from itof.capture.averaging import NO_LIGHT
from itof.capture.number_range import refuse_range
from itof.capture.phase_steps import phasor_weights
from itof.capture.raw_frames import RawFrames
from itof.capture.sidecar import CaptureError, Sidecar

_STUCK = 0.01  # response of a tap over that of the taps that respond most
_WHOLE_TURN = 1.05  # periods that phases may span, with some slack for offsets
_NEAREST_M, _FARTHEST_M = 0.05, 20.0  # median depth; others must be in another unit
# Distances of walls, ours; those of the paper are 1 to 3 m away.
WALLS_M: Final[tuple[float, float]] = (0.2, 6.0)
_UNITS = {"millimetres": 1000.0, "metres": 1.0, "centimetres": 100.0, "inches": 1 / 0.0254}  # in a metre

Complexes = NDArray[np.complex128]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class SensorPixels:
    """Which sensor pixels can be used; (H, W) each.

    Attributes
    ----------
    saturated : at some frame, frequency, step or tap. Such a pixel is left out of all frames: choosing its
        dark frames would bias it.
    dead : gives the same number everywhere, or no light.
    """

    saturated: Mask
    dead: Mask

    @property
    def good(self) -> Mask:
        """Neither saturated nor dead."""
        return ~(self.saturated | self.dead)


def frame_phasors(raw: RawFrames, sidecar: Sidecar) -> Iterator[Complexes]:
    """(H, W, F) phasors of each frame, per second of exposure; their phases grow with distance."""
    signs = _row_signs(raw, sidecar) if sidecar.alternating_row_sign else None
    weights = phasor_weights(sidecar.steps, sidecar.taps) if sidecar.is_raw else None
    turn = _turn(raw, sidecar)
    dark = None if raw.dark is None else raw.dark.mean(axis=0, dtype=np.float64)
    for place, exposure_s in enumerate(raw.exposures_s):
        frame = raw.values[place]  # (F, S, T, H, W)
        partner = None if raw.partner is None else raw.partner[place]
        if weights is not None:
            numbers = frame.astype(np.float64) - (0.0 if dark is None else dark)
            flat = numbers.reshape(len(numbers), len(weights), -1)  # (F, S T, H W)
            z = (weights @ flat).reshape(len(numbers), *frame.shape[-2:])
        else:
            z = _image(frame, partner, sidecar)[:, 0, 0]
        z = z if sidecar.phase_sign > 0 else z.conj()
        z = z if signs is None else z * signs[:, None]
        z = z if turn is None else z * turn
        yield np.moveaxis(z, 0, -1) / exposure_s


def _turn(raw: RawFrames, sidecar: Sidecar) -> Complex | None:
    """(F or 1, H or 1, W or 1) factors that take out the phase offsets of the frequencies and pixels."""
    if not sidecar.phase_offsets_rad and raw.offsets_rad is None:
        return None
    whole = np.array(sidecar.phase_offsets_rad or (0.0,))[:, None, None]
    return np.asarray(np.exp(-1j * (whole + (0.0 if raw.offsets_rad is None else raw.offsets_rad))))


def sensor_pixels(raw: RawFrames, sidecar: Sidecar) -> SensorPixels:
    """Which sensor pixels can be used.

    Raises
    ------
    CaptureError : none can: all are saturated or dead, a frequency or a tap shows nothing, or the numbers are
        in another unit than the sidecar says.
    """
    height, width = raw.values.shape[-2:]
    saturated, dead = np.zeros((height, width), np.bool_), np.ones((height, width), np.bool_)
    first = raw.values[0].reshape(-1, height, width)[0]
    judged = raw.partner if sidecar.amplitude_arrays and raw.partner is not None else raw.values
    imaginary = raw.partner if sidecar.imaginary_arrays else None
    for place, (values, strength) in enumerate(zip(raw.values, judged, strict=True)):
        if sidecar.saturation is not None:
            saturated |= _reaches(strength, sidecar.saturation).any(axis=(0, 1, 2))
            if imaginary is not None:
                saturated |= _reaches(imaginary[place], sidecar.saturation).any(axis=(0, 1, 2))
        lit = sidecar.is_raw or strength.any() or (imaginary is not None and imaginary[place].any())
        if len(raw.values) > 1 and not lit:
            raise CaptureError(f"{raw.source}: frame {place} {NO_LIGHT}")
        if sidecar.is_raw:
            dead &= (values == first).all(axis=(0, 1, 2))
    if not sidecar.is_raw:
        dead = _dark_somewhere(raw, sidecar)
    dead |= raw.lost
    _refuse_units(raw, sidecar)
    if sidecar.is_raw:
        refuse_range(raw, sidecar)
    if saturated.all():
        raise CaptureError(f"{raw.source}: all pixels are saturated: capture with a shorter exposure")
    _refuse_silent(raw, sidecar, ~saturated)
    if (saturated | dead).all():
        raise CaptureError(f"{raw.source}: no pixel holds light, or all that do are saturated: capture again")
    return SensorPixels(saturated, dead)


def _reaches(values: Numbers, size: float) -> NDArray[np.bool_]:
    """Whether numbers are as large; the absolute value of the smallest whole number of a type overflows."""
    if values.dtype.kind == "c":
        return np.asarray(np.abs(values) >= size)
    return np.asarray((values >= size) | (values <= -size))


def _image(frame: Numbers, partner: Numbers | None, sidecar: Sidecar) -> Complex:
    """(F, 1, 1, H, W) phasors of images that were demodulated before."""
    if partner is None:
        return frame.astype(np.complex128)
    if sidecar.layout == "phasors":
        return frame.astype(np.float64) + 1j * partner.astype(np.float64)
    if sidecar.layout == "amplitude-phase":
        return partner.astype(np.float64) * np.exp(2j * np.pi * frame.astype(np.float64) / _period(sidecar))
    depth_m = frame.astype(np.float64) / _PER_METRE[sidecar.depth_unit]
    if sidecar.depth_along == "axis":
        depth_m = radial_from_z(depth_m, sidecar.horizontal_fov_deg)
    frequencies_hz = np.array(sidecar.frequencies_hz).reshape(-1, 1, 1, 1, 1)
    return np.asarray(partner * phasor_of_return(depth_m, frequencies_hz))


_PER_METRE: Final = {"m": 1.0, "mm": 1000.0}


def _period(sidecar: Sidecar) -> float:
    if sidecar.phase_period_dn is not None:
        return sidecar.phase_period_dn
    return 360.0 if sidecar.phase_unit == "deg" else 2 * np.pi


def _row_signs(raw: RawFrames, sidecar: Sidecar) -> NDArray[np.float64]:
    """(H,) 1, -1, 1, ... from both edges of the sensor to its middle."""
    height = raw.sensor[1]
    row = np.arange(height)
    signs = 1.0 - 2.0 * (np.minimum(row, height - 1 - row) % 2)
    first = 0 if sidecar.window is None else sidecar.window[1]
    return signs[first : first + raw.values.shape[-2]]


def _dark_somewhere(raw: RawFrames, sidecar: Sidecar) -> Mask:
    """(H, W) pixels of images that hold no light at some frame or frequency."""
    if sidecar.amplitude_arrays and raw.partner is not None and raw.partner.min() < 0:
        raise CaptureError(f"{raw.source}: an amplitude is negative ({raw.partner.min():g}): wrong array?")
    if sidecar.amplitude_arrays and raw.partner is not None:
        empty = raw.partner == 0
        if sidecar.layout == "amplitude-depth":
            empty |= raw.values == 0  # how cameras mark a pixel without a value
        return np.asarray(empty.any(axis=(0, 1, 2, 3)))
    empty = raw.values == 0 if raw.partner is None else (raw.values == 0) & (raw.partner == 0)
    return np.asarray(empty.any(axis=(0, 1, 2, 3)))


def _refuse_units(raw: RawFrames, sidecar: Sidecar) -> None:
    """Phases and depths that must be in another unit."""
    if sidecar.layout == "phasors" and raw.partner is None and raw.values.dtype.kind != "c":
        raise CaptureError(
            f"{raw.source}: phasors must be complex, Re + j Im, got {raw.values.dtype}; name the arrays of "
            "the imaginary parts by imaginary_arrays"
        )
    if sidecar.layout == "amplitude-phase":
        span = float(raw.values.max()) - float(raw.values.min())
        if span > _WHOLE_TURN * _period(sidecar):
            hint = "degrees or numbers" if sidecar.phase_unit == "rad" else "another number of them"
            raise CaptureError(
                f"{raw.source}: the phases span {span:g} {sidecar.phase_unit}, more than one period "
                f"({_period(sidecar):g}): correct phase_unit; {hint}?"
            )
        if sidecar.phase_unit == "deg" and float(np.abs(raw.values).max()) < 2 * np.pi * _WHOLE_TURN:
            raise CaptureError(
                f"{raw.source}: the phases span only {span:g} of 360 degrees: correct phase_unit; radians?"
            )
    if sidecar.layout in ("amplitude-depth", "depth"):
        _refuse_depths(raw, sidecar)
    if sidecar.layout == "depth":
        low, high = (float(each) / _PER_METRE[sidecar.depth_unit] for each in _middle_depths(raw))
        raise CaptureError(
            f"{raw.source}: it holds one depth image for all frequencies ({low:.2f} to {high:.2f} m in most "
            "pixels): the camera has computed it from the phases, which are lost, and with them the hidden "
            "light: record raw frames or the phases of each frequency"
        )


def _middle_depths(raw: RawFrames) -> NDArray[np.float64]:
    """Depths that 5 % of the pixels with a value are below and above."""
    measured = raw.values[raw.values > 0]
    return np.percentile(measured.astype(np.float64), [5, 95]) if measured.size else np.zeros(2)


def _refuse_depths(raw: RawFrames, sidecar: Sidecar) -> None:
    """Depths that must be in another unit."""
    measured = raw.values[0][raw.values[0] != 0]
    middle = float(np.median(measured)) if measured.size else 0.0
    if middle <= 0 or _NEAREST_M <= middle / _PER_METRE[sidecar.depth_unit] <= _FARTHEST_M:
        return
    fitting = [name for name, metre in _UNITS.items() if WALLS_M[0] <= middle / metre <= WALLS_M[1]]
    raise CaptureError(
        f"{raw.source}: half of the depths are above {middle:g} {sidecar.depth_unit}: "
        f"{'? '.join(fitting) or 'in which unit are they'}?"
    )


def _refuse_silent(raw: RawFrames, sidecar: Sidecar, usable: Mask) -> None:
    """A frequency or a tap that shows nothing."""
    judged = raw.partner if sidecar.amplitude_arrays and raw.partner is not None else raw.values
    for place, frequency_hz in enumerate(sidecar.frequencies_hz):
        one = judged[0, place][..., usable].reshape(-1)[0]
        if all((frame[place][..., usable] == one).all() for frame in judged):
            raise CaptureError(
                f"{raw.source}: every number at {megahertz(frequency_hz)} is {one:g}: a "
                "missing frequency? capture it, or take it out of frequencies_hz and of the file"
            )
    if sidecar.layout != "taps" or len(sidecar.taps) < 2:
        return
    response = _tap_response(raw, sidecar, usable)  # (F, T)
    silent = response < _STUCK * response.max(axis=1, keepdims=True)
    for place, tap in zip(*np.nonzero(silent), strict=True):
        raise CaptureError(
            f"{raw.source}: tap {tap} does not change with the light at "
            f"{megahertz(sidecar.frequencies_hz[place])}: is it stuck, or are axes or taps_rad wrong?"
        )


def _tap_response(raw: RawFrames, sidecar: Sidecar, usable: Mask) -> NDArray[np.float64]:
    """(F, T) how much the numbers of a tap change from step to step, or with one step from pixel to pixel."""
    frame = raw.values[0].astype(np.float64)[..., usable]  # (F, S, T, n)
    if len(sidecar.steps) > 1:
        return np.asarray(np.median(frame.max(axis=1) - frame.min(axis=1), axis=-1))
    return np.asarray(frame.std(axis=-1)[:, 0])
