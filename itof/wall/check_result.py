"""Outcome of a check of a measurement file: its findings, and the relay wall that its images show."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from itof.wall.finding import Finding, length
from itof.wall.wall_fit import RobustFit


@dataclass(frozen=True)
class WallSummary:
    """The relay wall as an image shows it, compared with that of the run or of the measured reference.

    Attributes
    ----------
    mean_shift_m, max_shift_m : mean and largest change of the wall's distance along the rays of the pixels,
        metres, without sign; the mean is weighted by the light.
    mean_shift_std_m : standard deviation of the mean, metres, with errors that are smooth over the image.
    distance_std_m, tilt_std_deg : the same for the wall's distance along its normal, metres, and its angle,
        degrees.
    distance_is_known : whether the phase offsets are as small as they should be.
    distance_shift_m : change of the wall's distance from the camera, metres; > 0: farther away.
    tilt_deg : angle between both walls, degrees.
    plane_per_m : (3,) the wall's plane m in camera axes (right, down, forward), 1/m: its distance along the
        ray r is 1 / (m · r).
    offsets_rad, offsets_std_rad : (F,) phase offsets and their standard deviations.
    residual_rms_rad : (F,) phases that are left, root mean square.
    coherence : (F,) share of the light that fits the wall in phase and amplitude, 0 to 1.
    """

    mean_shift_m: float
    max_shift_m: float
    mean_shift_std_m: float
    distance_std_m: float
    tilt_std_deg: float
    distance_is_known: bool
    distance_shift_m: float
    tilt_deg: float
    plane_per_m: tuple[float, ...]
    offsets_rad: tuple[float, ...]
    offsets_std_rad: tuple[float, ...]
    residual_rms_rad: tuple[float, ...]
    coherence: tuple[float, ...]

    @classmethod
    def of_fit(cls, fit: RobustFit) -> WallSummary:
        """The numbers of a fit, without its images."""
        values = {field.name: getattr(fit, field.name) for field in fields(cls)}
        lists = {name: tuple(each.tolist()) for name, each in values.items() if isinstance(each, np.ndarray)}
        return cls(**(values | lists))


@dataclass(frozen=True)
class FileFinding:
    """A finding, and the images that it is about.

    Attributes
    ----------
    code, sentence, refused : as in `itof.wall.finding.Finding`; the numbers are those of the first image.
    images : names of the images; empty if the finding is about the reference.
    """

    code: str
    sentence: str
    refused: bool
    images: tuple[str, ...]


def joined(found: Iterable[tuple[Finding, str | None]]) -> tuple[FileFinding, ...]:
    """Findings of the same kind as one; their numbers differ from image to image."""
    joined: dict[tuple[str, bool, bool], FileFinding] = {}
    for finding, name in found:
        kind = (finding.code, finding.refused, name is None)
        before = joined.get(kind, FileFinding(finding.code, finding.sentence, finding.refused, ()))
        images = before.images if name is None else (*before.images, name)
        joined[kind] = FileFinding(before.code, before.sentence, before.refused, images)
    return tuple(joined.values())


@dataclass(frozen=True)
class MeasurementCheck:
    """Outcome of `model.prediction.measurement_check.check_measured`.

    Attributes
    ----------
    findings : what makes predictions doubtful; empty for a plausible measurement.
    walls : the wall in each image; None where there is none, or where the check ended early.
    measured_reference : whether the walls are compared with that of a measured reference.
    ignored : names of arrays in the file that are not used.
    """

    findings: tuple[FileFinding, ...]
    walls: tuple[WallSummary | None, ...]
    measured_reference: bool
    ignored: tuple[str, ...]

    @property
    def refused(self) -> bool:
        """Whether predictions would be useless."""
        return any(finding.refused for finding in self.findings)

    def doubts(self, image: str) -> bool:
        """Whether a finding is about the image of this name, or about the reference."""
        return any(not finding.images or image in finding.images for finding in self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings, one sentence each, with the images that they are about if there are several."""
        return tuple(self._about(finding) for finding in self.findings)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was compared with what, the wall that was found, and arrays that were ignored."""
        if self.measured_reference:
            reference, place = "measured (the array reference)", "the reference"
        else:
            reference, place = "computed from the camera and the wall of the run", "the run"
        told = [f"reference: {reference}"]
        shifts_m = [wall.mean_shift_m for wall in self.walls if wall is not None]
        if shifts_m:
            missing = len(self.walls) - len(shifts_m)
            some = f" in {len(shifts_m)} of {len(self.walls)} images" if missing else ""
            shift = f"{_range(shifts_m)} (mean along the rays)"
            told.append(f"the wall is found{some} {shift} from where {place} has it")
        if self.ignored:
            read = "phasors, frequencies_hz, reference and horizontal_fov_deg"
            told.append(f"ignored arrays: {', '.join(self.ignored)}; only {read} are read")
        return tuple(told)

    def _about(self, finding: FileFinding) -> str:
        if len(self.walls) == 1 or not finding.images:
            return finding.sentence
        more = len(finding.images) - 1
        others = f" and {more} more" if more else ""
        return f"{finding.sentence} (image {finding.images[0]}{others})"


def _range(lengths_m: list[float]) -> str:
    """Lengths as text: ``0.1 mm``, or ``0.1 mm to 2.0 cm``."""
    low, high = length(min(lengths_m)), length(max(lengths_m))
    return low if low == high else f"{low} to {high}"
