"""What `model.prediction.prediction_files.predict_file` says of the images of a file."""

from __future__ import annotations

import base64
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from disk import NightError
from disk.counted import counted
from disk.told import Told
from itof.wall.check_result import MeasurementCheck, WallSummary
from itof.wall.empty_corner import CapturedPlane
from model.prediction.explained_light import ExplainedLight
from model.prediction.explanation import Explanation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST_TOLD_M: Final = 1e-3
_MOST_SHOWN: Final = 8  # pictures in a notebook


class PredictionError(NightError):
    """The output folder has other files than those of a prediction, or lacks what is asked for."""


@dataclass(frozen=True)
class PredictedImage:
    """Files of one predicted image, and what it shows.

    Attributes
    ----------
    name : name of its files, without ending.
    object_pixels : number of pixels that show the hidden object.
    median_radial_depth_m : median radial depth of these pixels, metres; None if there are none.
    files : names of its files in the output folder.
    wall : the relay wall as the measurement shows it; None if it shows none.
    horizontal_fov_deg : field of view that the image was taken to have, degrees.
    expected_mae_m : MAE over all pixels that the network expects, metres; None without probabilities, and
        after a finding: no network knows what it expects of what it was not trained on.
    expected_depth_error_m : mean absolute error of these pixels' depth that the network expects, metres; None
        if it expects none, without an object, and after a finding.
    light : hidden light, and how much of it the depth map explains; None without residual channels.
    explanation : the solids that refinement has found; None without refinement, or where there is none.
    doubted : whether a finding has taken away the expected errors.
    """

    name: str
    object_pixels: int
    median_radial_depth_m: float | None
    files: tuple[str, ...]
    wall: WallSummary | None
    horizontal_fov_deg: float
    expected_mae_m: float | None = None
    expected_depth_error_m: float | None = None
    light: ExplainedLight | None = None
    explanation: Explanation | None = None
    doubted: bool = False

    @property
    def sentence(self) -> str:
        """The outcome as text."""
        own = "; after the warning, its error is unknown" if self.doubted else ""
        own += "" if self.expected_mae_m is None else f"; expected MAE {_centimetres(self.expected_mae_m)}"
        own += "" if self.light is None else f"; {self.light.words}"
        own += "" if self.explanation is None else f"; {self.explanation.words}"
        if self.median_radial_depth_m is None:
            return f"image {self.name}: no pixel shows an object, so it has no point cloud{own}"
        return (
            f"image {self.name}: {self.object_pixels} pixels show an object, at a median radial depth of "
            f"{self.median_radial_depth_m:.2f} m{self._depth_error}{own}"
        )

    def after(self, check: MeasurementCheck) -> PredictedImage:
        """The same without the network's expected errors, if a finding is about the image or the reference.

        What an accepted explanation lets expect rests on the light, and stays.
        """
        is_known = self.explanation is not None and self.explanation.accepted
        if is_known or self.expected_mae_m is None or not check.doubts(self.name):
            return self
        return replace(self, expected_mae_m=None, expected_depth_error_m=None, doubted=True)

    @property
    def _depth_error(self) -> str:
        error_m = self.expected_depth_error_m
        return "" if error_m is None else f"; expected error of the depth {_centimetres(error_m)}"


def _centimetres(error_m: float) -> str:
    """An error as text; no network knows that it makes none."""
    return f"{100 * error_m:.1f} cm" if error_m >= _LEAST_TOLD_M else f"below {100 * _LEAST_TOLD_M:g} cm"


@dataclass(frozen=True, repr=False)
class FilePrediction(Told):
    """Outcome of `predict_file`.

    Attributes
    ----------
    images : the predicted images, in the order of the file.
    check : how the measurement compares with the relay wall of the run.
    folder : that with the files of the images.
    wall : of the reference; None without one, or if the network does not need to know it.
    """

    images: tuple[PredictedImage, ...]
    check: MeasurementCheck
    folder: Path
    wall: CapturedPlane | None = None

    def __repr__(self) -> str:
        return (
            f"FilePrediction of {counted(len(self.images), 'image')} in {self.folder}\n{self.sentences[-1]}"
        )

    @property
    def has_pictures(self) -> bool:
        """Whether the images were drawn."""
        return all(f"{image.name}.png" in image.files for image in self.images)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The outcome as text: the reference, the wall, and what each image shows."""
        wall = () if self.wall is None else (self.wall.sentence,)
        return (*self.check.sentences, *wall, *(image.sentence for image in self.images))

    def plot(self) -> Figure:
        """The pictures of the first images, below each other.

        Raises
        ------
        PredictionError : no pictures were drawn.
        """
        import matplotlib.pyplot as plt

        if not self.has_pictures:
            raise PredictionError(f"{self.folder} has no pictures: predict with pictures=True")
        pictures = [plt.imread(self.folder / f"{image.name}.png") for image in self.images[:_MOST_SHOWN]]
        height, width = np.sum([picture.shape[0] for picture in pictures]), pictures[0].shape[1]
        figure, axes = plt.subplots(
            len(pictures), figsize=(12, 12 * height / width), squeeze=False, layout="constrained"
        )
        for place, picture in zip(axes[:, 0], pictures, strict=True):
            place.imshow(picture)
            place.axis("off")
        return figure

    def _repr_html_(self) -> str:
        """The sentences, and the pictures of the first images, for a notebook."""
        files = [self.folder / f"{image.name}.png" for image in self.images[:_MOST_SHOWN]]
        pictures = [base64.b64encode(file.read_bytes()).decode() for file in files if file.is_file()]
        shown = "".join(f'<img src="data:image/png;base64,{picture}">' for picture in pictures)
        return super()._repr_html_() + shown
