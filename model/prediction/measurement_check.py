"""Whether a measurement file holds what the network of a run was trained on: light from its relay wall.

`itof.wall.plausibility` judges one image; here all images of a file and its reference are judged together.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from disk import PathLike
from disk.quantities import FREQUENCY
from itof import amplitude
from itof.files.measurement_files import Measurement, MeasurementError, read_measurement
from itof.wall.check_result import MeasurementCheck, WallSummary, joined
from itof.wall.finding import Finding
from itof.wall.plausibility import check_measurement, check_reference
from model.prediction.fields_of_view import predictors_of, view_findings, with_fields_of_view
from model.prediction.predictor import NEEDS_CAPTURE, Predictor, load
from model.run_folder.networks import View, Wanted, what_to_do
from model.settings.run import DeviceName
from processes.progress import showing_progress

OTHER_UNIT: Final = 10.0  # times the mean amplitude of the training scenes: far beyond what scenes differ by
NO_CAPTURE: Final = (
    "the network was trained with captures of the empty corner, and here is none: give one as reference"
)
MOST_REFUSED: Final = 20  # images, after which the rest is not checked: a file of noise is refused in seconds


class ImplausibleError(MeasurementError):
    """A measurement is not that of the run's relay wall; predictions from it would be useless."""


def check_file(
    run: PathLike,
    measurement_file: PathLike,
    *,
    horizontal_fov_deg: float | None = None,
    device: DeviceName = "auto",
) -> MeasurementCheck:
    """Compare a measurement file with the relay wall of a run, without a prediction.

    Parameters
    ----------
    horizontal_fov_deg : as in `predict_file`.

    Raises
    ------
    MeasurementError : as in `predict_file`, but not for what the check finds.
    RunError, DeviceError : the run or the device cannot be used.
    """
    predictor = load(run, device)
    measured = fitting_measurement(predictor, Path(measurement_file), Path(run), horizontal_fov_deg)
    return check_measured(predictor, measured, rescale=not measured.in_training_unit, thorough=True)


def fitting_measurement(
    predictor: Predictor, file: Path, run: Path, horizontal_fov_deg: float | None = None
) -> Measurement:
    """Read a measurement at the frequencies of the run, with its field of view; refuse another image size."""
    config = predictor.config
    whole = with_fields_of_view(read_measurement(file), horizontal_fov_deg)
    wanted = wanted_for(whole)
    try:
        measured = whole.at(config.inputs.frequencies_hz)
    except MeasurementError as error:
        if max(whole.frequencies_hz) < FREQUENCY.least:
            raise  # in another unit
        raise MeasurementError(f"{error}; {what_to_do(wanted)}") from None
    if not config.reads(wanted.width, wanted.height):
        raise MeasurementError(
            f"{file} holds images of {wanted.width}x{wanted.height} pixels, {run} was trained on "
            f"{config.image_width}x{config.image_height}: scale the images; {what_to_do(wanted)}"
        )
    if measured.reference is None and config.inputs.needs_capture:
        raise MeasurementError(f"{file} has no array reference, and {run} {NEEDS_CAPTURE}")
    return measured


def wanted_for(measured: Measurement, check: MeasurementCheck | None = None) -> Wanted:
    """What a network for a measurement must be for; with the walls of its images if there is a `check`."""
    height, width = measured.phasors.shape[1:3]
    walls = [None] * len(measured.phasors) if check is None else [*check.walls]
    views_deg = measured.fields_of_view_deg or (None,) * len(walls)
    views = {
        View(view_deg, None if wall is None else wall.plane_per_m)
        for view_deg, wall in zip(views_deg, walls, strict=True)
    }
    return Wanted(width, height, measured.frequencies_hz, tuple(views))


def check_measured(
    predictor: Predictor,
    measured: Measurement,
    *,
    rescale: bool = False,
    thorough: bool = False,
    progress: bool = False,
) -> MeasurementCheck:
    """Compare every image of a measurement, and its reference, with the relay wall of the run.

    Parameters
    ----------
    measured : at the frequencies of the run, with images of its size (`fitting_measurement`).
    rescale : whether the amplitudes will be brought to those of the training scenes.
    thorough : check every image, even if many of them or the reference are refused.
    """
    calibrated = predictor.config.inputs.self_calibrates
    seeing = predictors_of(predictor, measured)
    names = [f"{index:06d}" for index in range(len(measured.phasors))]
    walls: list[WallSummary | None] = [None] * len(names)
    found: list[tuple[Finding, str | None]] = []  # with the image's name; None for the reference
    if measured.reference is not None:
        found += [(finding, None) for finding in check_reference(measured.reference, seeing(0).wall)]
    elif predictor.config.saw_captures:
        found.append((Finding("no-capture", NO_CAPTURE, False), None))
    useless, most = sum(finding.refused for finding, _ in found), MOST_REFUSED
    if useless and not thorough:
        most = 0  # all images would be compared with a wrong reference
    with showing_progress(len(names), "image", "check", show=progress and len(names) > 1) as bar:
        for index, name in enumerate(names):
            if useless > most and not thorough:
                break
            seen = check_measurement(
                *(measured.phasors[index], seeing(index).wall, measured.reference),
                self_calibrated=calibrated,
                known_shift_m=predictor.config.inputs.largest_shift_m,
            )
            walls[index] = None if seen.wall is None else WallSummary.of_fit(seen.wall)
            findings = [
                *view_findings(predictor.config, measured.fields_of_view_deg[index : index + 1]),
                *seen.findings,
                *([] if rescale else _amplitude_findings(predictor, measured, index)),
            ]
            found += [(finding, name) for finding in findings]
            useless += any(finding.refused for finding in findings)
            bar.update()
    return MeasurementCheck(joined(found), tuple(walls), measured.reference is not None, measured.ignored)


def _amplitude_findings(predictor: Predictor, measured: Measurement, index: int) -> list[Finding]:
    """Amplitudes far from those of the training, for a network that uses them."""
    inputs = predictor.config.inputs
    if "paper" not in inputs.channels:
        return []
    with np.errstate(over="ignore"):  # `Predictor.predict` refuses what is too large
        times = float(amplitude(measured.phasors[index, ..., 0]).mean()) / inputs.mean_amplitude
    if 1 / OTHER_UNIT < times < OTHER_UNIT:
        return []
    words = f"the mean amplitude is {times:.2g} times that of the training scenes: use --rescale?"
    return [Finding("other-unit", words, False)]
