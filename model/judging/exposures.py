"""A network judged behind a camera, at several exposures or with one imperfection after the other."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from disk import PathLike, whole_folder
from disk.own_files import refuse_other_files
from itof import ImageFileError, read_image
from itof.metrics import ImageMetrics, Summary, image_metrics, no_object_metrics, summarise
from itof.sensor.imperfections import cameras_by_imperfection
from itof.sensor.scene_camera import MeasuredScene, SceneCamera
from itof.sensor.settings import MOST_FRAMES, SensorSettings
from model.data.rows import RowBlock
from model.data.sensor_draws import view_problem
from model.data.shards import Shards
from model.judging.exposure_results import (
    FIGURE_FILE,
    ExposureReport,
    ExposureRow,
    files_of_exposures,
    write_exposure_figure,
)
from model.judging.judged_split import open_split, seeing
from model.judging.refusals import EvaluationError
from model.network.channels import ChannelError
from model.prediction.predictor import Predictor, load
from model.run_folder.shipped import run_folder
from model.settings.run import DeviceName
from processes.progress import showing_progress
from scenegen import MEASUREMENT_FILE, Dataset, Split

_log = logging.getLogger(__name__)

_STREAM = 0xE890  # of the noise, apart from those of other random numbers
_NEEDED = "a camera needs the direct and the hidden light that night-render writes"


def judge_exposures(
    run: PathLike,
    dataset: Dataset,
    out: PathLike,
    sensor: SensorSettings,
    *,
    exposures: Sequence[int] = (1,),
    corner_exposures: int = 0,
    each_imperfection: bool = False,
    first: int | None = None,
    split: Split = "test",
    force: bool = False,
    device: DeviceName = "auto",
    progress: bool = True,
) -> ExposureReport:
    """Judge a network on scenes as a modelled camera measures them, and write the folder `out`.

    ``exposures.json`` holds all numbers, ``exposures.csv`` a line for each camera, ``exposures.png``, for
    several exposures, error and mIoU against the light. The folder is written whole or not at all and
    replaces earlier results.

    Parameters
    ----------
    sensor : the camera; its `frames` are those of one exposure.
    exposures : numbers of exposures that are averaged, one row of results each.
    corner_exposures : exposures of the empty corner, as the same camera measures it, that are averaged to the
        network's reference; 0 for no capture.
    each_imperfection : instead of one row for each number of exposures: at one number, the camera with each
        of its imperfections alone, and with all but this one.
    first : judge the first so many scenes of the split only.
    force : as in `model.evaluate`.

    Raises
    ------
    EvaluationError : the split has no scenes; the run does not fit the images, or these not the sensor; a
        number is not positive or too large; or `out` contains other things than earlier results.
    RunError, DeviceError, ShardError, ImageFileError : run, device or renders cannot be used.
    """
    run, out = run_folder(run), Path(out).resolve()
    refuse_other_files(out, files_of_exposures, "judgement of exposures", EvaluationError)
    _refuse_numbers(sensor, exposures, corner_exposures, first)
    if each_imperfection and len(set(exposures)) > 1:
        raise EvaluationError(
            f"imperfections are judged at one number of exposures, got {list(exposures)}: give one"
        )
    if dataset.is_measured:
        raise EvaluationError(f"{dataset.root} holds captures of a camera: no other one can measure them")
    predictor = load(run, device)
    if predictor.config.inputs.needs_capture and not corner_exposures:
        raise EvaluationError(f"{run} was trained for a capture of the empty corner: give --corner-exposures")
    shards, rows, unlike = open_split(
        predictor.config, run, dataset, split, force=force, progress=progress, first=first
    )
    for sentence in unlike:
        _log.warning("warning: %s", sentence)
    frequencies_hz = predictor.config.inputs.frequencies_hz
    size = shards.manifest.width, shards.manifest.height
    problem = view_problem(sensor, dataset.preset, dataset.root, *size, frequencies_hz)
    if problem:
        raise EvaluationError(problem)
    work = _Work(seeing(predictor, dataset, shards), dataset, shards, rows)
    named = _cameras(sensor, exposures, each_imperfection)
    cameras = [(name, work.camera(settings, corner_exposures * sensor.frames)) for name, settings in named]
    with whole_folder(out) as folder:
        with showing_progress(len(rows) * len(cameras), "scene", "expose", show=progress) as bar:
            results = tuple(work.row(name, camera, bar.update) for name, camera in cameras)
        report = ExposureReport(
            sensor, corner_exposures * sensor.frames, results, *work.limits(captured=corner_exposures > 0)
        )
        if len(results) > 1 and not each_imperfection:
            write_exposure_figure(folder / FIGURE_FILE, report)
        origin = {
            "run_id": predictor.config.run_id,
            "data_sha256": shards.manifest.data_sha256,
            "split": split,
            "scene_count": len(rows),
        }
        report.write(folder, origin)
        refuse_other_files(out, files_of_exposures, "judgement of exposures", EvaluationError)
    return report


def _refuse_numbers(
    sensor: SensorSettings, exposures: Sequence[int], corner_exposures: int, first: int | None
) -> None:
    if not exposures or min(exposures) < 1:
        raise EvaluationError(f"exposures are whole numbers from 1 on, got {list(exposures)}")
    if corner_exposures < 0 or (first is not None and first < 1):
        raise EvaluationError(
            "the number of exposures of the corner is at least 0, that of scenes at least 1"
        )
    if max(*exposures, corner_exposures) * sensor.frames > MOST_FRAMES:
        raise EvaluationError(
            f"{max(*exposures, corner_exposures)} exposures of {sensor.frames} frames are more than "
            f"{MOST_FRAMES} frames: give fewer exposures"
        )


def _cameras(
    sensor: SensorSettings, exposures: Sequence[int], each_imperfection: bool
) -> Iterator[tuple[str, SensorSettings]]:
    """Cameras by name; their `frames` are those of the exposures."""
    if each_imperfection:
        yield from cameras_by_imperfection(replace(sensor, frames=sensor.frames * exposures[0]))
    else:
        for count in sorted(set(exposures)):
            yield "all", replace(sensor, frames=sensor.frames * count)


@dataclass(frozen=True)
class _Work:
    """What all cameras have in common."""

    predictor: Predictor
    dataset: Dataset
    shards: Shards
    rows: Sequence[int]

    def camera(self, settings: SensorSettings, corner_frames: int) -> SceneCamera:
        """The camera in front of the scenes, and `corner_frames` measurements of the empty corner."""
        manifest, frequencies_hz = self.shards.manifest, self.predictor.config.inputs.frequencies_hz
        return SceneCamera(settings, frequencies_hz, manifest.width, manifest.height, corner_frames)

    def row(self, name: str, camera: SceneCamera, count: Any) -> ExposureRow:
        """Results of one camera."""
        metrics: list[ImageMetrics] = []
        measured: list[MeasuredScene] = []
        for row in self.rows:
            block = self.shards.read([row])
            seen = self._measured(camera, row)
            found = self.predictor.predict(seen.phasor, seen.corner)
            metrics.append(_judged(found.radial_depth_m, found.mask, block))
            measured.append(seen)
            count(1)
        electrons = float(np.mean([each.electrons for each in measured]))
        frames, settings = camera.settings.frames, camera.settings
        raw_frames = frames * settings.phase_steps * len(camera.frequencies_hz)
        pixel, image = np.mean([each.snr for each in measured], axis=0)
        return ExposureRow(
            name,
            frames,
            camera.light_s,
            electrons * raw_frames,
            _finite(camera.phase_noise_rad(electrons)),
            _finite(pixel),
            _finite(image),
            float(np.mean([each.saturated for each in measured])),
            summarise(metrics),
        )

    def _measured(self, camera: SceneCamera, row: int) -> MeasuredScene:
        """The scene of a row of the shards; this number and that of the exposures decide the noise."""
        rng = np.random.default_rng([_STREAM, row, camera.settings.frames])
        phasor, direct, hidden = self._light(row)
        return camera.measure(phasor, direct, hidden, rng)

    def _light(self, row: int) -> list[Any]:
        """(H, W, F) phasors of a scene as rendered: all light, direct and hidden."""
        (scene,) = self.shards.ids([row])
        file = self.dataset.render_folder(scene) / MEASUREMENT_FILE
        image = read_image(file)
        try:
            parts = [image.phasors(part) for part in ("itof", "direct", "hidden")]
            light = [phasor[..., self.predictor.config.inputs.places(found)] for phasor, found in parts]
        except (ImageFileError, ChannelError) as error:
            raise EvaluationError(f"{file}: {error}; {_NEEDED}") from None
        if not all(np.isfinite(phasor).all() for phasor in light):
            raise EvaluationError(f"{file} has phasors that are not finite: render the scene again")
        return light

    def limits(self, *, captured: bool) -> tuple[Summary, Summary]:
        """Metrics of the network without a camera, and of predicting no object.

        Parameters
        ----------
        captured : whether the network gets the empty corner, too.
        """
        perfect, nothing = [], []
        for row in self.rows:
            block = self.shards.read([row])
            phasor, direct, _ = self._light(row)
            found = self.predictor.predict(phasor, direct if captured else None)
            perfect.append(_judged(found.radial_depth_m, found.mask, block))
            nothing.append(no_object_metrics(block.radial_depth_m[0], block.mask[0]))
        return summarise(perfect), summarise(nothing)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _judged(radial_depth_m: Any, mask: Any, block: RowBlock) -> ImageMetrics:
    return image_metrics(radial_depth_m, mask, block.radial_depth_m[0], block.mask[0])
