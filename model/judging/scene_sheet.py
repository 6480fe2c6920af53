"""Truth and prediction of every judged scene in one picture, from which the report's page cuts them."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from itof import DepthMap
from itof.pictures.depth_film import depth_levels, depth_palette
from itof.pictures.figures import depth_range

_MOST_PIXELS: Final = 4_000_000  # of the picture; larger images lose rows and columns
_GAP: Final = 1  # pixels between truth and prediction
_WHITE: Final = 255


@dataclass
class SceneSheet:
    """Tiles (h, w) with the truth on the left and the prediction on the right, in `depth_palette`.

    Attributes
    ----------
    count : number of scenes to come.
    tiles, ranges_m : of the scenes so far, by id; the depths at the ends of the colours.
    """

    count: int
    tiles: dict[str, NDArray[np.uint8]] = field(default_factory=dict)
    ranges_m: dict[str, tuple[float, float]] = field(default_factory=dict)

    def add(self, scene: str, truth: DepthMap, prediction: DepthMap) -> None:
        """Add a scene (H, W). Its colours span the true object, or the predicted one in an empty corner."""
        self.ranges_m[scene] = range_m = depth_range(truth, prediction)
        step = math.ceil(math.sqrt(2 * self.count * truth.mask.size / _MOST_PIXELS))
        ours, theirs = (depth_levels(each, range_m)[::step, ::step] for each in (prediction, truth))
        gap = np.full((len(ours), _GAP), _WHITE, np.uint8)
        self.tiles[scene] = np.hstack([theirs, gap, ours])

    def as_data(self, order: list[str]) -> dict[str, Any]:
        """The picture with scenes in this order, row by row; its columns and the size of a tile, pixels."""
        height, width = self.tiles[order[0]].shape
        columns = math.ceil(math.sqrt(len(order) * height / width))
        rows = math.ceil(len(order) / columns)
        sheet = np.full((rows * height, columns * width), _WHITE, np.uint8)
        for place, scene in enumerate(order):
            row, column = divmod(place, columns)
            sheet[row * height :, column * width :][:height, :width] = self.tiles[scene]
        picture, file = Image.fromarray(sheet).convert("P"), BytesIO()
        picture.putpalette(depth_palette())
        picture.save(file, "PNG", optimize=True)
        content = base64.b64encode(file.getvalue()).decode()
        return {
            "src": f"data:image/png;base64,{content}",
            "columns": columns,
            "width": width,
            "height": height,
        }
