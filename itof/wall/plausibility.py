"""Whether a measurement can be what it is taken for: light from the relay wall where the wall should be.

A network answers any input. `itof.wall.image_defects` finds what is no image at all. Almost all light of a
measurement comes straight from the relay wall, so what else is wrong shows in how it differs from the wall's
expected return: the amplitudes (`itof.wall.brightness`), the conventions of the file
(`itof.wall.phase_defects`, `itof.wall.frequency_defects`), the pose of camera and wall and the calibration of
the camera (`itof.wall.wall_search`). The limits rest on the distributions in docs/science/design.md (Wall
found in the measurement).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from disk.frequency_text import megahertz
from itof.arrays import Floats, Phasors
from itof.unwrapping import combined_range_m
from itof.wall.brightness import EVEN, brightness_findings
from itof.wall.expected_wall import NumpyWall
from itof.wall.finding import Finding, length
from itof.wall.frequency_defects import other_frequency
from itof.wall.image_defects import fit_defects, image_defects
from itof.wall.phase_defects import alternatives, find_defects, mismatch
from itof.wall.wall_fit import RobustFit, without_unit
from itof.wall.wall_search import found, locate_wall

MISFIT_NOTED_RAD: Final = 4e-3  # 1.6 mm of wall at 60 MHz; bright hidden light looks like 2.7 mrad
MISFIT_REFUSED_RAD: Final = 12.5e-3  # 5 mm at 60 MHz: predictions are worse than none (notebook/training.md)
# For a self-calibrated run. Its channels do not depend on the wall's place, but hidden light falls elsewhere.
# Chosen by the size of the object, not measured.
CALIBRATED_NOTED_M: Final = 0.02
CALIBRATED_REFUSED_M: Final = 0.2
SCATTER_NOTED_RAD: Final = 0.03  # twice that of a valid measurement with 1 % of noise and bright hidden light
SCATTER_REFUSED_RAD: Final = 0.1  # a hundred times the hidden light of most pixels
STRANGE_NOTED: Final = 0.01  # share of pixels that do not fit the wall at all
_SIGMAS = 3.0
_DIM = 0.01  # of the median weight: a tenth of its amplitude
_OPPOSITE = 1.9  # mismatch with the reference; 2 if all phases differ by half a turn
_SMALL_PART = 0.25  # of the phases of a shift: the offsets that may be beside it
_SMALL_TILT_DEG = 0.05
_SMALL_SHIFT_M = 5e-5


@dataclass(frozen=True)
class Plausibility:
    """What `check_measurement` found, and the wall as the measurement shows it.

    Attributes
    ----------
    findings : empty for a plausible measurement.
    wall : fit of the wall, relative to a measured reference if there is one; None if there is no wall.
    """

    findings: tuple[Finding, ...]
    wall: RobustFit | None


def check_measurement(
    phasor: Phasors,
    wall: NumpyWall,
    reference: Phasors | None = None,
    *,
    self_calibrated: bool = False,
    known_shift_m: float = 0.0,
) -> Plausibility:
    """Compare one measurement with the return of the relay wall.

    Parameters
    ----------
    phasor : (H, W, F) complex, finite, in any unit.
    wall : the wall where it should be, at the same frequencies.
    reference : (H, W, F) measurement of the empty corner that `check_reference` accepts. It may show a wall
        in another place and any phase offsets, since that is what it is for: the wall's place and the
        offsets of the measurement are then compared with it.
    self_calibrated : whether the channels are made by `itof.wall.self_calibration`. Phase offsets then do not
        matter, and neither does a small shift of the wall.
    known_shift_m : mean shift of the wall, metres, up to which a self-calibrated run has seen walls.

    Raises
    ------
    ValueError : another shape than that of the expected wall, or values that are not finite.
    """
    phasor = without_unit(phasor, wall)
    reference = None if reference is None else without_unit(reference, wall)
    free_offsets = self_calibrated or reference is not None
    if spoilt := tuple(image_defects(phasor, wall.frequencies_hz)):
        return Plausibility(spoilt, None)
    findings = _amplitudes_and_conventions(phasor, wall, free_offsets=free_offsets)
    if known_shift_m and any(finding.code == "convention" for finding in findings):
        seen = locate_wall(phasor, wall, direct=reference)
        if seen is not None and found(seen) and seen.mean_shift_m <= known_shift_m:
            # Phases of a wall at half the distance look halved; this one is where the run has seen walls.
            findings = _amplitudes_and_conventions(phasor, wall, free_offsets=free_offsets, scaled=False)
    if any(finding.refused for finding in findings):
        return Plausibility(findings, None)
    if (
        reference is not None
        and not self_calibrated
        and mismatch(phasor, replace(wall, direct=reference)) > _OPPOSITE
    ):
        words = "measurement and reference have opposite signs: multiply one of them by -1?"
        return Plausibility((*findings, Finding("convention", words, True)), None)
    fit = locate_wall(phasor, wall, direct=reference)
    if fit is not None and (words := other_frequency(phasor, fit)):
        return Plausibility((*findings, Finding("convention", words, True)), None)
    if fit is None or not found(fit):
        return Plausibility((*findings, _no_wall(phasor, wall, reference is not None)), None)
    if spoilt := tuple(fit_defects(phasor, fit)):
        return Plausibility((*findings, *spoilt), fit)
    compared = reference is not None
    place = _place(fit, compared)
    if self_calibrated:
        shift_m = fit.mean_shift_m - _SIGMAS * fit.mean_shift_std_m
        expecting = "the reference" if compared else "the run"
        place = elsewhere(shift_m, describe_shift(fit), expecting, known_shift_m)
    return Plausibility((*findings, *place, *_scatter(fit)), fit)


def check_reference(reference: Phasors, wall: NumpyWall) -> tuple[Finding, ...]:
    """What is wrong with a measurement of the empty corner, except for the wall's place and phase offsets.

    Raises
    ------
    ValueError : another shape than that of the expected wall, or values that are not finite.
    """
    reference = without_unit(reference, wall)
    findings = tuple(image_defects(reference, wall.frequencies_hz))
    findings = findings or _amplitudes_and_conventions(reference, wall, free_offsets=True)
    if not any(finding.refused for finding in findings):
        fit = locate_wall(reference, wall)
        if fit is None or not found(fit):
            findings = (*findings, _no_wall(reference, wall, compared=False))
    return tuple(Finding(each.code, f"the reference: {each.sentence}", each.refused) for each in findings)


def describe_shift(fit: RobustFit) -> str:
    """How far the wall is from its expected place."""
    return shift_words(fit.distance_shift_m, fit.tilt_deg)


def shift_words(shift_m: float, tilt_deg: float) -> str:
    """A change of a wall's distance and angle as text: ``5.0 cm farther away and tilted by 0.2 degrees``."""
    parts = []
    if abs(shift_m) >= _SMALL_SHIFT_M:
        parts.append(f"{length(abs(shift_m))} {'farther away' if shift_m > 0 else 'nearer'}")
    if tilt_deg >= _SMALL_TILT_DEG:
        parts.append(f"tilted by {tilt_deg:.1f} degrees")
    return " and ".join(parts) or "where it should be"


def _amplitudes_and_conventions(
    phasor: Phasors, wall: NumpyWall, *, free_offsets: bool, scaled: bool = True
) -> tuple[Finding, ...]:
    findings = [*brightness_findings(phasor, wall)]
    if any(each.code == "no-wall" for each in findings):
        return tuple(findings)
    if (_phase_spread(phasor, wall) < EVEN**2 * _phase_spread(wall.direct, wall)).all():
        findings.append(Finding("no-wall", "no wall found: the phase is the same in all pixels", True))
    elif defects := find_defects(phasor, wall, free_offsets=free_offsets, scaled=scaled):
        findings.append(Finding("convention", alternatives(defects), True))
    return tuple(findings)


def _phase_spread(phasor: Phasors, wall: NumpyWall) -> Floats:
    """(F,) 1 - |mean of e^{j phase}| over the lit pixels, weighted by |d|²."""
    lit = (phasor != 0).all(-1)
    strength = np.abs(wall.direct[lit][:, 0]).astype(np.float64)
    weight = (strength / strength.max()) ** 2
    turned = np.exp(1j * np.angle(phasor[lit]))
    spread: Floats = 1 - np.abs(weight @ turned) / weight.sum()
    return spread


def _no_wall(phasor: Phasors, wall: NumpyWall, compared: bool) -> Finding:
    """Why the phases at all frequencies together are not those of a wall."""
    if compared:
        return Finding("no-wall", "measurement and reference do not show the same wall", True)
    good = []
    for place, frequency_hz in enumerate(wall.frequencies_hz):
        alone, wall_alone = phasor[..., [place]], wall.at([place])
        if defects := find_defects(alone, wall_alone):
            return Finding("convention", f"at {megahertz(frequency_hz)}: {alternatives(defects)}", True)
        good.append(found(locate_wall(alone, wall_alone)))
    right = [f for f, fits in zip(wall.frequencies_hz, good, strict=True) if fits]
    wrong = [f for f, fits in zip(wall.frequencies_hz, good, strict=True) if not fits]
    if not right:
        words = "no wall found: the phases are not those of a flat wall"
        if len(wall.frequencies_hz) == 1:
            words += f" within {length(combined_range_m(wall.frequencies_hz))}, the unambiguous range"
    elif wrong:
        others = megahertz(*right)
        words = f"no wall found at {megahertz(*wrong)}: only the phases at {others} are those of a wall"
    else:
        words = f"no wall found: the phases at {megahertz(*right)} are not those of the same wall"
    return Finding("no-wall", words, True)


def _place(fit: RobustFit, compared: bool) -> Iterator[Finding]:
    """A wall that is not where it should be, or phase offsets."""
    misfit_rad = float((fit.misfit_rad - _SIGMAS * fit.misfit_std_rad).max())
    if misfit_rad < MISFIT_NOTED_RAD:
        return
    # A shift of the wall explains what it can of the phases; what is left to the offsets, it cannot.
    of_shift_rad = float((fit.wall.slope * fit.mean_shift_m).max())
    moved = float(np.abs(fit.offsets_rad).max()) <= _SMALL_PART * of_shift_rad
    offsets = ", ".join(f"{1e3 * offset:+.1f}" for offset in fit.mean_phase_rad)
    if moved:
        code, what = (
            "wall-moved",
            f"the wall is not where {'the reference' if compared else 'the run'} has it, ",
        )
        what += f"but {describe_shift(fit)}"
        if len(fit.wall.frequencies_hz) == 1:
            what += " (or the camera's phase is off)"
    else:
        code, what = (
            "phase-offsets",
            f"the phases at {megahertz(*fit.wall.frequencies_hz)} are off by {offsets} mrad ",
        )
        what += "since the reference" if compared else "everywhere"
    capture = (
        "capture the empty corner again" if compared else "give a capture of the empty corner as reference"
    )
    mend = "" if compared else "correct camera and wall, or " if moved else "calibrate the camera, or "
    yield Finding(code, f"{what}: {mend}{capture}", misfit_rad >= MISFIT_REFUSED_RAD)


def elsewhere(shift_m: float, words: str, place: str, known_shift_m: float) -> Iterator[Finding]:
    """A wall that is farther from its expected place than those that a self-calibrated run has seen.

    Parameters
    ----------
    shift_m : mean change of its distance along the rays, metres; `words` says how it moved (`shift_words`).
    place : what expects it elsewhere.
    """
    shift_m -= known_shift_m
    if shift_m < CALIBRATED_NOTED_M:
        return
    words = f"the wall is not where {place} has it, but {words}"
    if known_shift_m:
        words += f": the run has seen walls up to {length(known_shift_m)} from there (mean along the rays)"
    else:
        words += ": the run was trained on another corner"
    yield Finding("wall-moved", words, shift_m >= CALIBRATED_REFUSED_M)


def _scatter(fit: RobustFit) -> Iterator[Finding]:
    """Phases that scatter about the wall far more than hidden light makes them."""
    bright = fit.weight > _DIM * np.median(fit.weight[fit.weight > 0])  # noise alone may decide dim pixels
    strange = float((bright & ~fit.fits).sum() / bright.sum())
    if strange > STRANGE_NOTED:
        words = (
            f"the phases of {100 * strange:.2g} % of the pixels are not those of the wall: damaged pixels?"
        )
        yield Finding("strange-pixels", words, False)
    rms_rad = fit.residual_rms_rad
    if rms_rad.max() > SCATTER_NOTED_RAD:
        values = ", ".join(f"{1e3 * value:.0f}" for value in rms_rad)
        at = megahertz(*fit.wall.frequencies_hz)
        words = f"the phases scatter by {values} mrad at {at} about those of the wall, far more than by "
        words += "hidden light: too noisy?"
        yield Finding("scatter", words, bool(rms_rad.max() > SCATTER_REFUSED_RAD))
