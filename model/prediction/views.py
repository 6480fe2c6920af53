"""What pictures show of predictions; the pictures, and the film of all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from disk import whole_file
from itof import amplitude
from itof.arrays import Phasors
from itof.pictures.film import encode_film
from itof.pictures.plan import Plan, Room
from itof.pictures.prediction_picture import Scale, View, draw_prediction
from itof.wall.check_result import WallSummary
from model.prediction.explanation import RefinedImage
from model.prediction.predicted_image import PredictedImage
from model.prediction.predictor import Predictor
from processes.progress import showing_progress

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

FRAMES_PER_SECOND: Final = 8
_COMPRESSION: Final = 1  # of 9: twice as fast as the default, for files that are a third larger


def view_of(
    predictor: Predictor,
    found: RefinedImage,
    phasor: Phasors,
    reference: Phasors | None,
    wall: WallSummary | None,
    title: str,
) -> View:
    """What the picture of an image (H, W, F) shows; `wall` is the one that its light shows."""
    config = predictor.config
    hidden = predictor.hidden_light(phasor, reference)
    if hidden is not None:
        light, name = 1e3 * hidden, "hidden light, ‰ of the direct light"
    else:
        strength = amplitude(phasor[..., 0])
        light, name = strength / max(float(strength.max()), 1e-300), "measured light"
    plane = config.geometry.plane_per_m
    if wall is not None and wall.distance_is_known:
        plane = np.array(wall.plane_per_m)
    room = found.room or Room(np.array(config.geometry.camera_axes), plane)
    plan = Plan.of(found.depth_map, room, config.geometry.horizontal_fov_deg)
    is_probable = config.settings.predicts_probability
    return View(title, found.depth_map, light.astype(np.float32), name, plan, is_probable)


def draw_views(
    folder: Path | None,
    film: Path | None,
    images: Sequence[PredictedImage],
    views: Sequence[View],
    progress: bool,
) -> tuple[PredictedImage, ...]:
    """Write the pictures of images into a folder, and the film of all of them; either may be None.

    With a film, all pictures have the same colours. Returned are the images with their pictures.
    """
    views = [replace(view, knows_error=not image.doubted) for image, view in zip(images, views, strict=True)]
    pictures = _drawn(folder, images, views, None if film is None else Scale.of(views), progress)
    if film is not None:
        with whole_file(film) as partial:
            encode_film(partial, pictures, FRAMES_PER_SECOND)
    for _ in pictures:
        pass  # it is written
    if folder is None:
        return tuple(images)
    return tuple(replace(image, files=(*image.files, f"{image.name}.png")) for image in images)


def _drawn(
    folder: Path | None,
    images: Sequence[PredictedImage],
    views: Sequence[View],
    scale: Scale | None,
    progress: bool,
) -> Iterator[Picture]:
    """Draw and write one picture after the other."""
    with showing_progress(len(images), "picture", "draw", show=progress and len(images) > 1) as bar:
        for image, view in zip(images, views, strict=True):
            picture = draw_prediction(view, image.sentence, scale)
            if folder is not None:
                picture.save(folder / f"{image.name}.png", compress_level=_COMPRESSION)
            yield picture
            bar.update()
