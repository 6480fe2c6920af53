"""Check of a capture before any network sees it: what is wrong with it, in words and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from disk import PathLike
from disk.told import Told
from itof.capture.capture import ImageShape
from itof.capture.check_picture import refuse_other_picture, write_picture
from itof.capture.facts import CaptureFacts, milliradians
from itof.capture.image_check import ImageCheck, check_image, wall_distance_m
from itof.capture.images import CapturedImages, read_images
from itof.capture.importing import paths
from itof.wall.check_result import MeasurementCheck, WallSummary, joined
from itof.wall.finding import Finding, length
from itof.wall.plausibility import check_measurement
from itof.wall.wall_fit import RobustFit

MOST_REFUSED: Final = 20  # images, after which the rest is not checked
_REFERENCE = "the reference: "


@dataclass(frozen=True, repr=False)
class CaptureCheck(Told):
    """Outcome of `check_capture`.

    Attributes
    ----------
    found : findings, and the wall in each image.
    distances_m : median distance of the wall in each image, metres; None where there is none, or where the
        phase offsets leave it unknown.
    facts, reference_facts : of the capture and of that of the empty corner; None if unknown.
    image_size : width and height, pixels.
    """

    found: MeasurementCheck
    distances_m: tuple[float | None, ...]
    facts: CaptureFacts | None
    reference_facts: CaptureFacts | None
    image_size: tuple[int, int]
    frequencies_hz: tuple[float, ...]
    horizontal_fov_deg: float

    @property
    def refused(self) -> bool:
        """Whether predictions would be useless."""
        return self.found.refused

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, as text; the findings first."""
        told = [f"warning: {warning}" for warning in self.found.warnings] or ["fine: nothing is wrong"]
        for wall, away_m in zip(self.found.walls, self.distances_m, strict=True):
            if wall is not None:
                told.append(_place(wall, away_m))
        if self.facts is not None:
            told += self.facts.sentences
        if self.reference_facts is not None:
            told += [f"{_REFERENCE}{sentence}" for sentence in self.reference_facts.sentences]
        return tuple(told)

    def as_data(self) -> dict[str, Any]:
        """The outcome as plain data."""
        facts, reference = (
            None if each is None else asdict(each) for each in (self.facts, self.reference_facts)
        )
        return {
            "refused": self.refused,
            "findings": [asdict(finding) for finding in self.found.findings],
            "walls": [None if wall is None else asdict(wall) for wall in self.found.walls],
            "distances_m": list(self.distances_m),
            "facts": facts,
            "reference_facts": reference,
        }


def check_capture(
    inputs: PathLike | Sequence[PathLike],
    sidecar: PathLike | None = None,
    *,
    empty: PathLike | Sequence[PathLike] = (),
    changes: Sequence[str] = (),
    bin_side: int | None = None,
    size: tuple[int, int] | None = None,
    horizontal_fov_deg: float | None = None,
    picture: PathLike | None = None,
    progress: bool = True,
) -> CaptureCheck:
    """Judge raw frames, or a measurement file, without a network.

    Parameters that are not listed are those of `import_capture`.

    Parameters
    ----------
    inputs : raw frames with a `sidecar`; without, one measurement file as `import_capture` writes it.
    horizontal_fov_deg : of the image, degrees. A measurement file needs it if neither it nor a record of an
        import beside it has one.
    picture : PNG file to write; it shows the first image that is refused, or else the first one. Only an
        earlier picture of a check is replaced.

    Raises
    ------
    CaptureError : a file or the sidecar cannot be used, a file is given twice, the field of view is not
        known, or `picture` is another file. What the check finds is no error.
    MeasurementError : the measurement file cannot be read.
    """
    if picture is not None:
        refuse_other_picture(Path(picture))
    shape = ImageShape(bin_side, size, horizontal_fov_deg)
    images = read_images(inputs, sidecar, empty=empty, changes=changes, shape=shape, progress=progress)
    checks = _each(images)
    found: list[tuple[Finding, str | None]] = []
    if images.reference is not None:
        found += [(each, None) for each in _of_reference(images, checks)]
    found += [(each, f"{place:06d}") for place, check in enumerate(checks) for each in check.findings]
    missing = [None] * (len(images.phasors) - len(checks))
    shown = [_wall(check) for check in checks]
    away = [wall_distance_m(fit) if fit is not None and fit.distance_is_known else None for fit in shown]
    walls = [None if fit is None else WallSummary.of_fit(fit) for fit in shown]
    result = CaptureCheck(
        MeasurementCheck(joined(found), (*walls, *missing), images.reference is not None, ()),
        (*away, *missing),
        images.facts,
        images.reference_facts,
        (images.phasors.shape[2], images.phasors.shape[1]),
        images.frequencies_hz,
        images.fov_deg,
    )
    if picture is not None:
        _draw(Path(picture), paths(inputs)[0].name, images, checks, result)
    return result


def _each(images: CapturedImages) -> list[ImageCheck]:
    """The images, one by one, until too many are refused."""
    checks: list[ImageCheck] = []
    useless = 0
    for image in images.phasors:
        if useless > MOST_REFUSED:
            break
        known = (images.facts, images.offset_std_rad)
        checks.append(check_image(image, images.frequencies_hz, images.fov_deg, *known))
        useless += any(finding.refused for finding in checks[-1].findings)
    return checks


def _of_reference(images: CapturedImages, checks: list[ImageCheck]) -> list[Finding]:
    """What is wrong with the empty corner, and with the first image compared with it."""
    reference = images.reference
    if reference is None:
        return []
    known = (images.reference_facts, images.offset_std_rad)
    check = check_image(reference, images.frequencies_hz, images.fov_deg, *known)
    found = [Finding(each.code, f"{_REFERENCE}{each.sentence}", each.refused) for each in check.findings]
    bad = any(finding.refused for each in (check, checks[0]) for finding in each.findings)
    if not bad and check.fit is not None:
        # Phase offsets drift from capture to capture. Self-calibrated networks do not mind; prediction
        # checks what its network minds.
        compared = check_measurement(images.phasors[0], check.fit.wall, reference, self_calibrated=True)
        found += [each for each in compared.findings if each.code in ("wall-moved", "no-wall")]
    return found


def _place(wall: WallSummary, away_m: float | None) -> str:
    """How far the wall is and how certain that is, and the phases that are left."""
    offsets, left = milliradians(wall.offsets_rad), f"{milliradians(wall.residual_rms_rad)} are left"
    if away_m is not None:
        return (
            f"the wall is {length(away_m)} away, uncertain by {length(wall.distance_std_m)}; phase offsets "
            f"{offsets}; {left}"
        )
    return (
        f"the wall's distance is unknown, because the phase offsets are too large: {offsets}, give or take "
        f"{milliradians(wall.offsets_std_rad)}; measure them, and write them into the sidecar as "
        f"phase_offsets_rad; {left}"
    )


def _wall(check: ImageCheck) -> RobustFit | None:
    """The wall of an image that shows one."""
    return None if any(finding.refused for finding in check.findings) else check.fit


def _draw(
    picture: Path, title: str, images: CapturedImages, checks: list[ImageCheck], result: CaptureCheck
) -> None:
    from itof.capture.check_figure import check_figure  # matplotlib takes half a second to load

    refused = [place for place, check in enumerate(checks) if any(each.refused for each in check.findings)]
    place = refused[0] if refused else 0
    fit, said = checks[place].fit, "; ".join(result.found.warnings) or "fine: nothing is wrong"
    write_picture(picture, check_figure(title, images.phasors[place], images.saturated_part, fit, said))
