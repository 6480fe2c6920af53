"""Prediction on a measurement file: a folder with depth maps (EXR), pictures and point clouds."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from itof import DepthMap
from model.prediction.figures import prediction_figure, write_figure
from model.prediction.measurement_files import Measurement, MeasurementError, read_measurement
from model.prediction.pointclouds import object_points, write_point_cloud
from model.prediction.predictor import BATCH, InputError, Predictor, load
from model.settings import DeviceName
from scenegen import NightError, whole_folder, write_text
from scenegen.progress import showing_progress

PREDICTION_SCHEMA: Final = 1
RECORD: Final = "prediction.json"


class PredictionError(NightError):
    """The output folder contains other files than those of an earlier prediction."""


@dataclass(frozen=True)
class PredictedImage:
    """Files of one predicted image, and what it shows.

    Attributes
    ----------
    name : name of its files, without ending.
    object_pixels : number of pixels that show the hidden object.
    median_radial_depth_m : median radial depth of these pixels, metres; None if there are none.
    files : names of its files in the output folder.
    """

    name: str
    object_pixels: int
    median_radial_depth_m: float | None
    files: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The outcome as text."""
        if self.median_radial_depth_m is None:
            return f"image {self.name}: no pixel shows an object, so it has no point cloud"
        return (
            f"image {self.name}: {self.object_pixels} pixels show an object, at a median radial depth of "
            f"{self.median_radial_depth_m:.2f} m"
        )


def predict_file(
    run: Path,
    measurement_file: Path,
    out: Path,
    *,
    rescale: bool | None = None,
    device: DeviceName = "auto",
    progress: bool = True,
) -> tuple[PredictedImage, ...]:
    """Predict every image of a measurement file and write the folder `out`.

    ===================  =====================================================================================
    ``000000.exr``       depth map of image 0: ``depth.R``, ``mask.M`` and phasor, as in ``mirrored.exr``
    ``000000.png``       picture of the depth map
    ``000000.ply``       point cloud; missing if no pixel shows an object
    ``prediction.json``  run, measurement and files of the prediction
    ===================  =====================================================================================

    The folder is written whole or not at all and replaces an earlier prediction.

    Parameters
    ----------
    run : run folder of the trained network.
    rescale : as in `Predictor.predict`; None rescales unless the file is in the unit of rendered scenes.

    Raises
    ------
    MeasurementError : the file cannot be read, or the run was trained for another image size or for
        frequencies that the file lacks.
    PredictionError : `out` contains anything but an earlier prediction.
    RunError, DeviceError : the run or the device cannot be used.
    """
    out = out.resolve()  # `whole_folder` needs a name; "." has none
    _refuse_other_contents(out)
    predictor = load(run, device)
    measured = read_measurement(measurement_file).at(predictor.config.inputs.frequencies_hz)
    _refuse_other_size(predictor, measured, run)
    chosen = not measured.in_training_unit if rescale is None else rescale
    with whole_folder(out) as folder:
        images = _predict_all(predictor, measured, chosen, folder, progress)
        record: dict[str, Any] = {
            "schema_version": PREDICTION_SCHEMA,
            "run": str(run.resolve()),
            "measurement": str(measurement_file.resolve()),
            "rescaled": chosen,
            "reference": "computed" if measured.reference is None else "measured",
            "depth": "radial (along the ray), metres; 0 on background",
            "images": [asdict(image) for image in images],
        }
        write_text(folder / RECORD, json.dumps(record, indent=2, allow_nan=False) + "\n")
    return images


def _predict_all(
    predictor: Predictor, measured: Measurement, rescale: bool, folder: Path, progress: bool
) -> tuple[PredictedImage, ...]:
    """Predict the images batch by batch and write their files."""
    images = []
    attributes = {
        "generator": f"night-eval predict {version('night-nlos')}",
        "measurement": measured.path.name,
    }
    count = len(measured.phasors)
    with showing_progress(count, "image", "predict", show=progress) as bar:
        for start in range(0, count, BATCH):
            batch = measured.phasors[start : start + BATCH]  # (n, H, W, F)
            try:
                predictions = predictor.predict(batch, measured.reference, rescale=rescale)
            except InputError as error:
                raise MeasurementError(f"{measured.path}, batch from image {start}: {error}") from None
            for index in range(len(batch)):
                name = f"{start + index:06d}"
                about = attributes | {"image": name}
                images.append(_write(folder, name, predictions[index], predictor, about))
                bar.update()
    return tuple(images)


def _write(
    folder: Path, name: str, one: DepthMap, predictor: Predictor, attributes: dict[str, str]
) -> PredictedImage:
    """Write depth map, picture and point cloud of one (H, W) prediction."""
    files = [f"{name}.exr", f"{name}.png"]
    one.write(folder / files[0], attributes)
    write_figure(folder / files[1], prediction_figure(f"{attributes['measurement']}, image {name}", one))
    points_m = object_points(one.radial_depth_m, one.mask, predictor.config.geometry.horizontal_fov_deg)
    median_m = None
    if len(points_m):
        files.append(f"{name}.ply")
        write_point_cloud(folder / files[2], points_m)
        median_m = float(np.median(one.radial_depth_m[one.mask]))
    return PredictedImage(name, len(points_m), median_m, tuple(files))


def _refuse_other_size(predictor: Predictor, measured: Measurement, run: Path) -> None:
    config = predictor.config
    height, width = measured.phasors.shape[1:3]
    if (width, height) != (config.image_width, config.image_height):
        raise MeasurementError(
            f"{measured.path} holds images of {width}x{height} pixels, {run} was trained on "
            f"{config.image_width}x{config.image_height}: scale the images, or train a run at their size"
        )


def _refuse_other_contents(out: Path) -> None:
    """Refuse an output folder that contains anything but an earlier prediction."""
    if not out.exists():
        return
    if not out.is_dir():
        raise PredictionError(f"{out} is a file: give the prediction a folder of its own")
    names = {entry.name for entry in out.iterdir()}
    if names and not names <= _files_of_record(out / RECORD):
        raise PredictionError(
            f"{out} is not empty and holds other things than an earlier prediction: choose another folder"
        )


def _files_of_record(record: Path) -> set[str]:
    """Names of the files of an earlier prediction; empty if `record` is not its ``prediction.json``."""
    try:
        content = json.loads(record.read_text(encoding="utf-8"))
        if content["schema_version"] != PREDICTION_SCHEMA:
            return set()
        return {RECORD, *(str(name) for image in content["images"] for name in image["files"])}
    except (OSError, ValueError, TypeError, KeyError):
        return set()
