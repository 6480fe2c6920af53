"""What is wrong with one image of a capture, judged by the flat wall that it must show."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from disk.frequency_text import megahertz
from itof import combined_range_m
from itof.arrays import Floats, Phasors
from itof.capture.demodulating import WALLS_M
from itof.capture.facts import CaptureFacts, milliradians
from itof.light import OFFSET_STD_RAD
from itof.wall.brightness import DEAD_NOTED, SATURATED_NOTED, brightness_findings
from itof.wall.finding import Finding, length
from itof.wall.frequency_defects import other_frequency
from itof.wall.image_defects import fit_defects, image_defects
from itof.wall.plausibility import MISFIT_NOTED_RAD, SCATTER_REFUSED_RAD
from itof.wall.unknown_wall import see_wall
from itof.wall.wall_fit import WALL_SHARE, RobustFit, without_unit

NEAREST_M, FARTHEST_M = WALLS_M
NOT_FLAT_RAD: Final = 0.01  # smooth phases over a plane, root mean square; hidden light is 1 to 3 mrad
NO_WALL_RAD: Final = 0.05  # the same without four-cycle errors; cameras that have nothing else leave 6 mrad
NOISY_RAD: Final = 1e-3  # of a pixel: as much as weak hidden light
GOOD_NOISE_RAD: Final = 3e-4  # with 3.7e-4, an MAE of 1.3 cm rises to 3.5 (notebook/cameras.md)
SHARED: Final = 2.0  # noise of neighbours over that of the frames; dark frames of the same number give 1.4
LIT: Final = 0.5  # part of the pixels that should hold light
_EVEN = 1e-8  # half of the variance of phases that are the same; a wall seen at 5 degrees has 1e-6
_EXPLAINED = 0.5  # of the smooth phases that a shape of the wall must leave at most


@dataclass(frozen=True)
class ImageCheck:
    """Findings about one image, the wall that it shows, and the noise of its pixels.

    Attributes
    ----------
    findings : empty for an image without faults.
    fit : of the wall; None if the image holds almost no light, or does not show the wall as it stands.
    noise_rad : (F,) noise of a pixel's phase by the difference of neighbours, radians; fine structure of the
        light counts as noise. Empty without a wall.
    """

    findings: tuple[Finding, ...]
    fit: RobustFit | None
    noise_rad: tuple[float, ...]


def check_image(
    phasor: Phasors,
    frequencies_hz: Sequence[float],
    horizontal_fov_deg: float,
    facts: CaptureFacts | None = None,
    offset_std_rad: float | Sequence[float] = OFFSET_STD_RAD,
) -> ImageCheck:
    """Judge phasors (H, W, F) by a wall of which nothing is known.

    Parameters
    ----------
    facts : of the capture, if they are known: noise, drift and saturation.
    offset_std_rad : of the camera's phase offsets, as in `itof.wall.wall_fit.fit_wall`.

    Raises
    ------
    ValueError : values that are not finite.
    """
    if spoilt := tuple(image_defects(phasor, tuple(frequencies_hz))):
        return ImageCheck(spoilt, None, ())
    seen = see_wall(phasor, frequencies_hz, horizontal_fov_deg, offset_std_rad)
    if seen is None:
        words = "no wall found: no pixel holds light, or almost none"
        return ImageCheck((Finding("no-wall", words, True),), None, ())
    fit, defects = seen
    if words := other_frequency(phasor, fit):
        return ImageCheck((Finding("convention", words, True),), None, ())
    if defects:
        return ImageCheck((Finding("convention", " and ".join(defects), True),), None, ())
    if _is_even(phasor):
        words = "no wall found: the phase is the same in all pixels"
        return ImageCheck((Finding("no-wall", words, True),), fit, ())
    if not fit.shows_wall:
        return ImageCheck((_no_wall(fit),), fit, ())
    if spoilt := tuple(fit_defects(phasor, fit)):
        return ImageCheck(spoilt, fit, ())
    findings = list(brightness_findings(without_unit(phasor, fit.wall), fit.wall))
    noise = _local_rms(fit, fit.residual_rad)
    lit = float((phasor != 0).all(axis=-1).mean())
    if lit < LIT:
        findings.append(Finding("dark", f"only {100 * lit:.2g} % of the pixels hold light", False))
    shape = list(_shape(fit, noise))
    findings += [*_place(fit), *shape, *_scatter(noise), *_capture(facts, fit, noise)]
    if facts is not None and facts.noise_rad is not None and not shape:  # edges of a shape look like noise
        findings += _shared_noise(facts.noise_rad, tuple(noise.tolist()))
    told = {finding.code: finding for finding in reversed(findings)}  # saturation is told in two ways
    return ImageCheck(tuple(reversed(told.values())), fit, tuple(noise.tolist()))


def wall_distance_m(fit: RobustFit) -> float:
    """Median distance of the wall along the rays of the pixels that see it, metres."""
    return float(np.median(fit.wall.radial_depth_m[fit.weight > 0]))


def _is_even(phasor: Phasors) -> bool:
    """Whether the phase is the same in all pixels, at every frequency."""
    turned = np.exp(1j * np.angle(phasor[(phasor != 0).all(axis=-1)]))
    return bool((1 - np.abs(turned.mean(axis=0)) < _EVEN).all())


def _no_wall(fit: RobustFit) -> Finding:
    frequencies_hz, share = fit.wall.frequencies_hz, fit.wall_share
    wrong = [f for f, part in zip(frequencies_hz, share, strict=True) if part < WALL_SHARE]
    words = "no wall found: the phases are not those of a flat wall that fills the image"
    if len(wrong) < len(frequencies_hz):
        words = f"no wall found at {megahertz(*wrong)}: the phases are not those of the wall at the others"
    words += (
        ": is the camera turned to the wall, does the wall fill a part only (key window of the sidecar), and "
        "are axes, steps and signs right?"
    )
    return Finding("no-wall", words, True)


def _place(fit: RobustFit) -> Iterator[Finding]:
    """A wall out of range."""
    away_m = wall_distance_m(fit)
    if NEAREST_M <= away_m <= FARTHEST_M:
        return
    reach_m = combined_range_m(fit.wall.frequencies_hz)
    words = (
        f"the wall is found {length(away_m)} away, out of the range of {NEAREST_M:g} to {FARTHEST_M:g} m: "
        "wrong units, phase offsets of the camera, or a wall beyond the unambiguous range of "
        f"{length(reach_m)}?"
    )
    yield Finding("wall-range", words, False)


def _shape(fit: RobustFit, noise_rad: Floats) -> Iterator[Finding]:
    """Smooth phases over the plane: of the wall's shape, which grow with the frequency, or of the camera."""
    smooth = _smooth_rms(fit, fit.residual_rad, noise_rad)  # (F,)
    if smooth.max() < NOT_FLAT_RAD:
        return
    rest = fit.rest_rad
    useless = bool(_smooth_rms(fit, rest, _local_rms(fit, rest)).max() >= NO_WALL_RAD)
    slope = fit.wall.slope
    bump_m = fit.residual_rad @ slope / (slope @ slope)  # (H, W) least squares
    left = fit.residual_rad - bump_m[..., None] * slope
    unexplained = _smooth_rms(fit, left, _local_rms(fit, left))
    phases = f"{milliradians(tuple(smooth.tolist()))} at {megahertz(*fit.wall.frequencies_hz)}"
    if len(smooth) > 1 and unexplained.max() > _EXPLAINED * smooth.max():
        words = f"the phases leave those of a flat wall by {phases}, and no shape of the wall explains it: "
        if useless:
            words += "other pixels, steps or frequencies than declared, or something else in view?"
        else:
            words += "a camera whose waves are not sinusoidal (wiggling), or light scattered in the lens? "
            words += "Capture the empty corner, too (--empty), or take more phase steps"
        yield Finding("phase-errors", words, useless)
        return
    bump = length(float(np.sqrt((fit.weight * bump_m**2).sum() / fit.weight.sum())))
    words = f"the wall is not flat: it leaves its plane by {bump} (root mean square; {phases}); or something "
    words += "else is in view, or horizontal_fov_deg or lens are wrong"
    yield Finding("not-flat", words, useless)


def _scatter(noise_rad: Floats) -> Iterator[Finding]:
    if noise_rad.max() > SCATTER_REFUSED_RAD:
        noise = milliradians(tuple(noise_rad.tolist()))
        yield Finding("scatter", f"the phases of neighbouring pixels scatter by {noise}: too noisy", True)


def _capture(facts: CaptureFacts | None, fit: RobustFit, noise_rad: Floats) -> Iterator[Finding]:
    """What the frames say: noise, drift, saturated and dead pixels."""
    known = None if facts is None else facts.noise_rad
    told = tuple(noise_rad.tolist()) if known is None else known
    if max(told) > NOISY_RAD:
        by = "neighbouring pixels" if known is None else "the frames"
        times = math.ceil((max(told) / GOOD_NOISE_RAD) ** 2)
        words = (
            f"the noise of a pixel is {milliradians(told)}, measured from the scatter of {by}, and hidden "
            f"light is 1 to 3 mrad: average {times} times as many frames, or predict with a network that was "
            "trained for such noise (night-eval networks)"
        )
        yield Finding("noise", words, False)
    if facts is None:
        return
    if max(facts.drift_rad) > MISFIT_NOTED_RAD:
        words = (
            f"the phases drift by {milliradians(facts.drift_rad)} at {megahertz(*fit.wall.frequencies_hz)} "
        )
        words += f"within {facts.frames} frames: let the camera warm up, or capture for a shorter time"
        yield Finding("drift", words, False)
    if facts.saturated > SATURATED_NOTED:
        words = (
            f"{100 * facts.saturated:.2g} % of the sensor pixels are saturated: capture more frames with a "
        )
        words += "shorter exposure"
        yield Finding("saturated", words, False)
    if facts.dead > DEAD_NOTED:
        words = (
            f"{100 * facts.dead:.2g} % of the sensor pixels are dead: they give one number, NaN or no light"
        )
        yield Finding("dead-pixels", words, False)


def _shared_noise(frames_rad: tuple[float, ...], neighbours_rad: tuple[float, ...]) -> Iterator[Finding]:
    """Errors of single pixels that are the same in all frames, so that the frames do not scatter by them."""
    pairs = zip(frames_rad, neighbours_rad, strict=True)
    if any(near > max(SHARED * own, GOOD_NOISE_RAD) for own, near in pairs):
        words = (
            f"neighbouring pixels scatter by {milliradians(neighbours_rad)}, and the frames by only "
            f"{milliradians(frames_rad)}: few dark frames, whose noise is the same in all frames, or errors "
            "of single pixels; capture as many dark frames as frames, and the empty corner"
        )
        yield Finding("dark-noise", words, False)


def _local_rms(fit: RobustFit, phases: Floats) -> Floats:
    """(F,) noise by second differences of neighbours in a row, which smooth phases hardly change."""
    weight = np.minimum(np.minimum(fit.weight[:, 2:], fit.weight[:, :-2]), fit.weight[:, 1:-1])[..., None]
    bend = phases[:, 2:] - 2 * phases[:, 1:-1] + phases[:, :-2]  # with 6 times the variance of the noise
    return np.asarray(np.sqrt((weight * bend**2).sum(axis=(0, 1)) / (6 * max(weight.sum(), 1e-300))))


def _smooth_rms(fit: RobustFit, phases: Floats, noise_rad: Floats) -> Floats:
    """(F,) root mean square of phases without that of their noise."""
    mean = (fit.weight[..., None] * phases**2).sum(axis=(0, 1)) / fit.weight.sum()
    return np.asarray(np.sqrt(np.maximum(mean - noise_rad**2, 0.0)))
