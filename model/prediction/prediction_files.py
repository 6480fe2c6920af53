"""Prediction on measurement files: depth maps as EXR, pictures and point clouds, in a folder of their own."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from itof import DepthMap
from model.prediction.figures import BACKGROUND, depth_range, write_figure
from model.prediction.measurement_files import Measurement, MeasurementError, read_measurement
from model.prediction.pointclouds import object_points, write_point_cloud
from model.prediction.predictor import BATCH, Predictor, load
from model.settings import DeviceName
from scenegen import NightError, whole_folder, write_text
from scenegen.progress import showing_progress

PREDICTION_SCHEMA: Final = 1
RECORD: Final = "prediction.json"


class PredictionError(NightError):
    """A folder that holds something else than an earlier prediction."""


@dataclass(frozen=True)
class PredictedImage:
    """What was written of one image.

    Attributes
    ----------
    name : of its files, without ending.
    object_pixels : how many show the hidden object.
    median_radial_depth_m : of these, metres; None where there are none.
    files : names, in the prediction's folder.
    """

    name: str
    object_pixels: int
    median_radial_depth_m: float | None
    files: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The outcome, for people."""
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

    For image 000000: ``000000.exr`` (laid out like ``mirrored.exr``: ``depth.R``, ``mask.M`` and the phasor),
    ``000000.png`` (to look at), ``000000.ply`` (points, none where no pixel shows an object); and
    ``prediction.json``, which says what was predicted by which run. The folder appears whole or not at all;
    an earlier prediction there is replaced.

    Parameters
    ----------
    rescale : as of `Predictor.predict`; by default only for files whose unit is a camera's own.

    Raises
    ------
    MeasurementError : a file that cannot be read, or whose images or frequencies the run was not trained for.
    PredictionError : an `out` that holds anything but an earlier prediction.
    RunError, DeviceError : an unusable run or device.
    """
    out = out.resolve()  # a whole folder needs a name, which "." has not
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
    """Predict a batch at a time and write what comes out."""
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
            except ValueError as error:
                raise MeasurementError(f"{measured.path}, images from {start} on: {error}") from None
            for index in range(len(batch)):
                name = f"{start + index:06d}"
                about = attributes | {"image": name}
                images.append(_write(folder, name, predictions[index], predictor, about))
                bar.update()
    return tuple(images)


def _write(
    folder: Path, name: str, one: DepthMap, predictor: Predictor, attributes: dict[str, str]
) -> PredictedImage:
    """Depth map, picture and point cloud of one (H, W) prediction."""
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


def prediction_figure(title: str, one: DepthMap) -> Figure:
    """Re, Im and radial depth of one (H, W) prediction: the mask outlined in two, and alone in the third."""
    height, width = one.mask.shape
    figure = Figure(figsize=(10.5, 1.6 + 3.0 * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 3)
    near_m, far_m = depth_range(one)
    component = None
    for axes, part in zip(panels, (one.phasor.real, one.phasor.imag), strict=False):
        component = axes.imshow(part, vmin=-1, vmax=1, cmap="RdBu_r", interpolation="nearest")
        _outline(axes, one.mask)
    depth_m = np.where(one.mask, one.radial_depth_m, np.nan)  # NaN is drawn as background
    depth = panels[2].imshow(depth_m, vmin=near_m, vmax=far_m, cmap="viridis", interpolation="nearest")
    for axes, name in zip(panels, ("Re", "Im", "radial depth"), strict=True):
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(BACKGROUND)
        axes.set_title(name, fontsize=11)
    if component is not None:
        figure.colorbar(component, ax=list(panels[:2]), location="bottom", aspect=40, pad=0.03)
    bar = figure.colorbar(depth, ax=[panels[2]], location="bottom", aspect=20, pad=0.03, label="m")
    bar.locator = MaxNLocator(4)
    shown = int(np.count_nonzero(one.mask))
    said = f"{shown} of {width * height} pixels show an object" if shown else "no pixel shows an object"
    plain = title.replace("$", r"\$")  # a file's name is no formula
    figure.suptitle(f"{plain}\n{said}", fontsize=11)
    return figure


def _outline(axes: Axes, mask: NDArray[np.bool_]) -> None:
    """Draw the edges between pixels inside and outside of a (H, W) mask."""
    padded = np.pad(mask, 1)  # an object at the image's border has an outline there too
    rows, columns = np.nonzero(padded[1:, :] != padded[:-1, :])  # edges below padded row `rows`
    axes.hlines(rows - 0.5, columns - 1.5, columns - 0.5, colors="black", linewidth=0.8)
    rows, columns = np.nonzero(padded[:, 1:] != padded[:, :-1])
    axes.vlines(columns - 0.5, rows - 1.5, rows - 0.5, colors="black", linewidth=0.8)
    height, width = mask.shape
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)


def _refuse_other_size(predictor: Predictor, measured: Measurement, run: Path) -> None:
    config = predictor.config
    height, width = measured.phasors.shape[1:3]
    if (width, height) != (config.image_width, config.image_height):
        raise MeasurementError(
            f"{measured.path} holds images of {width}x{height} pixels, {run} was trained on "
            f"{config.image_width}x{config.image_height}: bring them to that size, or train a run at theirs"
        )


def _refuse_other_contents(out: Path) -> None:
    """Refuse to replace anything but an empty folder or an earlier prediction."""
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
    """Names of the files that an earlier prediction wrote; none when `record` is not one of ours."""
    try:
        content = json.loads(record.read_text(encoding="utf-8"))
        if content["schema_version"] != PREDICTION_SCHEMA:
            return set()
        return {RECORD, *(str(name) for image in content["images"] for name in image["files"])}
    except (OSError, ValueError, TypeError, KeyError):
        return set()
