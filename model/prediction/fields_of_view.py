"""The fields of view of the images in a measurement file, and whether a network has seen them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from disk import NightError
from disk.quantities import fov_problem
from itof.capture.record import imported_fov_deg
from itof.files.measurement_files import Measurement, MeasurementError
from itof.wall.finding import Finding
from model.prediction.predictor import Predictor
from model.run_folder.networks import seen_view
from model.run_folder.run_config import RunConfig
from scenegen import open_dataset


def with_fields_of_view(measured: Measurement, given_deg: float | None) -> Measurement:
    """The measurement with the field of view that is given; else with what is known of its own.

    That is what its file says, else the record of its import, else the scene of the dataset that has rendered
    it. Nothing may be known.

    Raises
    ------
    MeasurementError : no camera has the field of view that is given.
    """
    if given_deg is not None and (problem := fov_problem(given_deg)):
        raise MeasurementError(problem)
    if given_deg is None and measured.fields_of_view_deg:
        return measured
    known_deg = given_deg or imported_fov_deg(measured.path) or _rendered_fov_deg(measured.path)
    views_deg = () if known_deg is None else (known_deg,) * len(measured.phasors)
    return replace(measured, fields_of_view_deg=views_deg)


def _rendered_fov_deg(file: Path) -> float | None:
    """That of the scene whose render the file is, in a dataset; None if it is none."""
    folder = file.resolve().parent
    if folder.parent.name != "renders" or not (folder.parents[1] / "dataset.json").is_file():
        return None
    try:
        return open_dataset(folder.parents[1]).scene(folder.name).camera.horizontal_fov_deg
    except NightError:
        return None


def predictors_of(predictor: Predictor, measured: Measurement) -> Callable[[int], Predictor]:
    """The network with the size of the images, and with the field of view of the image of an index.

    Only the last one is kept: each has its wall's light, which is larger than the image.
    """
    height, width = measured.phasors.shape[1:3]
    predictor = predictor.for_size(width, height)
    views_deg, geometry = measured.fields_of_view_deg, predictor.config.geometry

    @lru_cache(maxsize=1)
    def seeing(view_deg: float) -> Predictor:
        return predictor.at(geometry.with_fov(view_deg))

    return lambda index: seeing(views_deg[index]) if views_deg else predictor


def view_findings(trained: RunConfig, fields_of_view_deg: Iterable[float]) -> Iterator[Finding]:
    """The first field of view, degrees, that the training of a network has not seen."""
    least_deg, most_deg = trained.trained_views_deg
    for view_deg in fields_of_view_deg:
        if not seen_view(trained, view_deg):
            seen = f"{least_deg:.4g}" if least_deg == most_deg else f"{least_deg:.4g} to {most_deg:.4g}"
            words = f"the field of view is {view_deg:.4g} degrees, and the training saw {seen}"
            if view_deg > most_deg:
                words += f" (a capture can be imported with --fov {most_deg:.4g})"
            yield Finding("other-view", words, True)
            return
