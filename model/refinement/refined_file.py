"""Refinement of the measurements in a file, without a dataset."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from disk import PathLike
from itof import DepthMap
from itof.pictures.plan import Room
from itof.wall.expected_wall import ExpectedWall
from model.device import one_thread
from model.prediction.explanation import RefinedImage
from model.prediction.predicted_image import FilePrediction
from model.prediction.prediction_files import predict_file
from model.prediction.predictor import load
from model.refinement.family import Family, family_of, refuse_misfit
from model.refinement.figures import light_figure
from model.refinement.light.corner_light import CornerLight, with_camera_at
from model.refinement.refining import refined
from model.refinement.room import corner_of, refuse_unseen_wall
from model.refinement.settings import LARGEST_MISFIT, UNKNOWNS, Unknown
from model.settings.run import DeviceName
from scenegen import Preset
from scenegen.corner_geometry import corners_of
from scenegen.pose import camera_axes


def refine(
    run: PathLike,
    measurement_file: PathLike,
    out: PathLike,
    *,
    room: Preset | None = None,
    objects: Preset | None = None,
    unknown: Sequence[Unknown] | None = None,
    largest_misfit: float = LARGEST_MISFIT,
    rescale: bool | None = None,
    horizontal_fov_deg: float | None = None,
    force: bool = False,
    device: DeviceName = "auto",
    progress: bool = True,
) -> FilePrediction:
    """Predict every image of a measurement file, and find the solids that explain it.

    The folder `out` is that of `predict_file`, with the depth maps of the solids that are accepted, and
    ``000000_light.png``: the light that was measured, what the solids explain of it, and what is left over.
    ``prediction.json`` holds the solids (`explanation`).

    Parameters
    ----------
    room : where the walls and the camera are, and the material of the relay wall. The measurement shows how
        far and how turned the camera is from the relay wall. None: nothing hides anything.
    objects : a preset with the shapes and extents of what may be there; None for all primitives.
    unknown : what of the object is fitted besides its pose; by default extents and reflectance, unless
        `objects` gives them.
    largest_misfit : share of the hidden light that may stay unexplained.

    Raises
    ------
    RoomError : the room is not that of the measurement.
    EvaluationError : `objects` has no shape that can be fitted, or `largest_misfit` is no number above 0.
    ImplausibleError, MeasurementError, PredictionError, RunError, DeviceError : as `predict_file`, which also
        has the other parameters.
    """
    refuse_misfit(largest_misfit)
    fitted = (UNKNOWNS if objects is None else ()) if unknown is None else unknown
    family = family_of(objects or Preset(), fitted)
    light = CornerLight(load(run, device).config.inputs.frequencies_hz, device)
    refiner = _FileRefiner(room, light, family, largest_misfit)
    return predict_file(
        *(run, measurement_file, out),
        rescale=rescale,
        horizontal_fov_deg=horizontal_fov_deg,
        force=force,
        device=device,
        progress=progress,
        refiner=refiner,
    )


@dataclass(frozen=True)
class _FileRefiner:
    """A `model.prediction.explanation.Refiner`."""

    room: Preset | None
    light: CornerLight
    family: Family
    largest_misfit: float

    def __call__(
        self,
        phasor: NDArray[Any],
        prediction: DepthMap,
        expected_m: float | None,
        wall: ExpectedWall,
        horizontal_fov_deg: float,
        title: str,
    ) -> RefinedImage:
        """The better depth map of an image (H, W, F)."""
        corner = corner_of(self.room, wall, horizontal_fov_deg)
        placed = with_camera_at(corner, np.asarray(wall.plane_per_m))
        refuse_unseen_wall(placed, wall.rays.reshape(-1, 3), self.light)
        seed = zlib.crc32(np.ascontiguousarray(phasor).tobytes())
        with one_thread():
            arguments = (phasor, prediction, expected_m, wall, corner, self.light, self.family)
            found = refined(*arguments, knows_camera=False, seed=seed)
        room = None
        if self.room is not None:
            camera = placed.camera
            middle_m = corners_of(placed.middle_wall) - camera.location_m
            room = Room(camera_axes(camera), np.asarray(wall.plane_per_m), middle_m)
        if found is None:
            return RefinedImage(prediction, room=room)
        outcome = found.explained(prediction, expected_m, self.largest_misfit)
        fit = found.fit
        (misfit,) = fit.comparison.misfits([fit.candidate])
        picture = light_figure(
            f"{title}\n{outcome.words}", fit.comparison.observed, misfit, wall.frequencies_hz
        )
        return RefinedImage(found.depth_map if outcome.accepted else prediction, outcome, picture, room)
