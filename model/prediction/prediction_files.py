"""Prediction on a measurement file: a folder with depth maps (EXR), pictures and point clouds."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from disk import PathLike, whole_folder, write_text
from disk.own_files import hashes_of, refuse_other_files
from disk.plain_file import MOST_LIST_BYTES, read_plain
from itof import DepthMap
from itof.arrays import Phasors
from itof.files.measurement_files import Measurement, MeasurementError
from itof.pictures.figures import write_figure
from itof.pictures.film import FILM_ENDINGS
from itof.pictures.pointclouds import object_points, write_point_cloud
from itof.pictures.prediction_picture import View
from itof.wall.check_result import MeasurementCheck, WallSummary, joined
from model.prediction.explained_light import ExplainedLight
from model.prediction.explanation import RefinedImage, Refiner
from model.prediction.fields_of_view import predictors_of
from model.prediction.measurement_check import (
    ImplausibleError,
    check_measured,
    fitting_measurement,
    wanted_for,
)
from model.prediction.predicted_image import FilePrediction, PredictedImage, PredictionError
from model.prediction.predictor import BATCH, InputError, Predictor, load
from model.prediction.views import draw_views, view_of
from model.run_folder.networks import OTHER_CORNER, what_to_do
from model.run_folder.shipped import run_folder
from model.settings.run import DeviceName
from processes.progress import showing_progress

# 1 had no `ignored`, `wall`, `findings`; 2 no plane of the wall; 3 no `reference_wall`; 4 no field of view;
# 5 no uncertainty of the wall, no `light`; 6 no `hideable` light; 7 no `explanation`; 8 one solid; 9 one
# field of view for all images, and errors that were expected in spite of findings; 10 no `other_scene`.
PREDICTION_SCHEMA: Final = 11
RECORD: Final = "prediction.json"


def predict_file(
    run: PathLike,
    measurement_file: PathLike,
    out: PathLike,
    *,
    rescale: bool | None = None,
    horizontal_fov_deg: float | None = None,
    force: bool = False,
    device: DeviceName = "auto",
    progress: bool = True,
    pictures: bool = True,
    film: PathLike | None = None,
    refiner: Refiner | None = None,
) -> FilePrediction:
    """Predict every image of a measurement file and write the folder `out`.

    ===================  =====================================================================================
    ``000000.exr``       depth map of image 0: ``depth.R``, ``mask.M`` and phasor, as in ``mirrored.exr``
    ``000000.png``       hidden light, probability, depth, expected error, and the room from above
    ``000000.ply``       point cloud; missing if no pixel shows an object
    ``prediction.json``  run, measurement, findings about it, and files of the prediction
    ===================  =====================================================================================

    The folder is written whole or not at all and replaces an earlier prediction. It is not replaced if it has
    got other files since, or if one of its files was changed.

    Parameters
    ----------
    run : run folder of the trained network, or the name of one that comes with the program.
    rescale : as in `Predictor.predict`; None rescales unless the file is in the unit of rendered scenes.
    horizontal_fov_deg : full field of view of the camera, 1 to 170 degrees. None takes that of the file, of
        its import or of the dataset that rendered it, and without any that of the training.
    force : predict also from a measurement that is not that of the run's relay wall.
    pictures : whether to draw the images.
    film : a ``.gif`` or ``.webp`` file to write: the pictures of all images in their order, which then have
        the same colours.
    refiner : finds the solid behind each depth map (`model.refine`).

    Raises
    ------
    ImplausibleError : the light in the file is not that of the run's relay wall: no wall, a wrong sign, order
        or axis, another pose, an uncalibrated camera; or what is predicted explains almost none of it, or the
        training had other fields of view. Not with `force`.
    MeasurementError : the file cannot be read, `horizontal_fov_deg` is no field of view, or the run was
        trained for another image size or for frequencies that the file lacks.
    PredictionError : `out` contains anything but an earlier prediction, or `film` cannot be a film.
    RunError, DeviceError : the run or the device cannot be used.
    """
    run, measurement_file, out = run_folder(run), Path(measurement_file), Path(out).resolve()
    film = None if film is None else _film_place(Path(film), out)
    _refuse_other_contents(out)
    predictor = load(run, device)
    measured = fitting_measurement(predictor, measurement_file, run, horizontal_fov_deg)
    chosen = not measured.in_training_unit if rescale is None else rescale
    check = check_measured(predictor, measured, rescale=chosen, thorough=force, progress=progress)
    _refuse_implausible(check, measured, run, force)
    seeing = predictors_of(predictor, measured)
    wall = None if measured.reference is None else seeing(0).found_wall(measured.reference)
    with whole_folder(out) as folder:
        drawing = pictures or film is not None
        images, views = _predict_all(seeing, measured, check, chosen, folder, progress, refiner, drawing)
        doubts = [
            (finding, image.name)
            for image in images
            if image.light is not None
            for finding in image.light.findings(shows_object=image.object_pixels > 0)
        ]
        check = replace(check, findings=(*check.findings, *joined(doubts)))
        images = tuple(image.after(check) for image in images)
        _refuse_implausible(check, measured, run, force)
        if film is not None and out in film.parents:
            film = folder / film.relative_to(out)  # one of the files of the prediction
        if drawing:
            images = draw_views(folder if pictures else None, film, images, views, progress)
        record: dict[str, Any] = {
            "schema_version": PREDICTION_SCHEMA,
            "run": str(run.resolve()),
            "measurement": str(measurement_file.resolve()),
            "rescaled": chosen,
            "reference": "computed" if measured.reference is None else "measured",
            "reference_wall": None if wall is None else wall.as_data(),
            "ignored": measured.ignored,
            "findings": [asdict(finding) for finding in check.findings],
            "depth": "radial (along the ray), metres; 0 on background",
            "images": [asdict(image) for image in images],
            "files": hashes_of(folder),
        }
        write_text(folder / RECORD, json.dumps(record, indent=2, allow_nan=False) + "\n")
        _refuse_other_contents(out)  # which may have got other files meanwhile
    return FilePrediction(images, check, out, wall)


def _refuse_implausible(check: MeasurementCheck, measured: Measurement, run: Path, force: bool) -> None:
    if check.refused and not force:
        refused = {finding.code for finding in check.findings if finding.refused}
        other = f"{what_to_do(wanted_for(measured, check))}; " if refused <= OTHER_CORNER else ""
        raise ImplausibleError(
            f"{measured.path} is not what {run} was trained on: {'; '.join(check.warnings)}; {other}"
            "with --force (force=True) it is predicted all the same"
        )


def _predict_all(
    seeing: Callable[[int], Predictor],
    measured: Measurement,
    check: MeasurementCheck,
    rescale: bool,
    folder: Path,
    progress: bool,
    refiner: Refiner | None,
    drawing: bool,
) -> tuple[tuple[PredictedImage, ...], list[View]]:
    """Predict the images batch by batch, each with its field of view, and write its depth map and points."""
    images, views, views_deg = [], [], measured.fields_of_view_deg
    attributes = {
        "generator": f"night-eval predict {version('night-nlos')}",
        "measurement": measured.path.name,
    }
    count = len(measured.phasors)
    with showing_progress(count, "image", "predict", show=progress) as bar:
        for start in range(0, count, BATCH):
            batch = measured.phasors[start : start + BATCH]  # (n, H, W, F)
            several = views_deg[start : start + BATCH] if len(set(views_deg)) > 1 else ()
            try:
                predictions = seeing(start).predict(
                    batch, measured.reference, rescale=rescale, fields_of_view_deg=several
                )
            except InputError as error:
                raise MeasurementError(f"{measured.path}, batch from image {start}: {error}") from None
            for index in range(len(batch)):
                predictor, name = seeing(start + index), f"{start + index:06d}"
                about = attributes | {"image": name}
                found, own_m = _refined(predictor, predictions[index], batch[index], measured, refiner, name)
                one = found.depth_map
                (light,) = predictor.explained_light(
                    batch[index][None], [one], measured.reference, thorough=True
                )
                wall = check.walls[start + index]
                image = _write(folder, name, one, wall, light, predictor, about)
                image = replace(image, expected_mae_m=own_m, explanation=found.explanation)
                if found.picture is not None:
                    image = replace(image, files=(*image.files, f"{name}_light.png"))
                    write_figure(folder / image.files[-1], found.picture)
                images.append(image)
                if drawing:
                    of = (batch[index], measured.reference, wall, measured.path.name)
                    views.append(view_of(predictor, found, *of))
                bar.update()
    return tuple(images), views


def _refined(
    predictor: Predictor,
    prediction: DepthMap,
    phasor: Phasors,
    measured: Measurement,
    refiner: Refiner | None,
    name: str,
) -> tuple[RefinedImage, float | None]:
    """The depth map of an image (H, W, F) to write, and the MAE that is expected of it, metres."""
    expected_m = predictor.expected_mae_m(prediction)
    wall = None if refiner is None else predictor.wall_of(measured.reference)
    if refiner is None or wall is None:
        return RefinedImage(prediction), expected_m
    fov_deg, title = predictor.config.geometry.horizontal_fov_deg, f"{measured.path.name}, image {name}"
    found = refiner(phasor, prediction, expected_m, wall, fov_deg, title)
    if found.explanation is not None and found.explanation.accepted:
        expected_m = found.explanation.expected_mae_m
    return found, expected_m


def _write(
    folder: Path,
    name: str,
    one: DepthMap,
    wall: WallSummary | None,
    light: ExplainedLight | None,
    predictor: Predictor,
    attributes: dict[str, str],
) -> PredictedImage:
    """Write depth map and point cloud of one (H, W) prediction."""
    files, fov_deg = [f"{name}.exr"], predictor.config.geometry.horizontal_fov_deg
    one.write(folder / files[0], attributes)
    points_m = object_points(one.radial_depth_m, one.mask, fov_deg)
    median_m = error_m = None
    if len(points_m):
        if one.depth_error_m is not None:
            error_m = float(one.depth_error_m[one.mask].mean(dtype=np.float64))
        files.append(f"{name}.ply")
        write_point_cloud(folder / files[1], points_m)
        median_m = float(np.median(one.radial_depth_m[one.mask]))
    return PredictedImage(name, len(points_m), median_m, tuple(files), wall, fov_deg, None, error_m, light)


def _film_place(film: Path, out: Path) -> Path:
    """Where to write a film; refuse what cannot be one."""
    if film.suffix.lower() not in FILM_ENDINGS:
        raise PredictionError(f"a film is a {' or '.join(FILM_ENDINGS)} file: cannot write {film}")
    place = film.parent.resolve() / film.name
    if place == out or place.is_dir():
        raise PredictionError(f"{film} is a folder: give the film a name of its own")
    return place


def _refuse_other_contents(out: Path) -> None:
    """Refuse an output folder that contains anything but an earlier prediction, as it was written."""
    refuse_other_files(out, files_of_prediction, "prediction", PredictionError)


def files_of_prediction(folder: Path) -> dict[str, str | None]:
    """Files of an earlier prediction, with SHA-256; empty if there is no prediction."""
    try:
        content = json.loads(read_plain(folder / RECORD, MOST_LIST_BYTES))
        if content["schema_version"] != PREDICTION_SCHEMA:
            return {}
        known = {str(name): str(sha256) for name, sha256 in content["files"].items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}
    return {**known, RECORD: None}
