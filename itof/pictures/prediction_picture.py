"""Picture of a prediction: hidden light, probability, depth, expected error, and the room from above.

It is drawn with Pillow, which takes a tenth of the time of matplotlib's figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image, ImageDraw

from itof import DepthMap
from itof.arrays import Reals
from itof.pictures.figures import depth_range
from itof.pictures.panels import FOOT, HEAD, INK, TEXT, WHITE, Colours, draw_panel, font, panel_size, wrapped
from itof.pictures.plan import Bounds, Plan, draw_plan

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

_GAP, _LINE = 16, TEXT + 6
_SHOWN_SHARE: Final = 99.5  # percent of the pixels whose light the colours span
_LEAST_ERROR_CM: Final = 0.1


@dataclass(frozen=True)
class View:
    """What the picture of an image shows.

    Attributes
    ----------
    title : its first line.
    answer : (H, W) prediction.
    light : (H, W) light that the network was given.
    light_name : what it is, and its unit.
    plan : the room from above.
    is_probable : whether the amplitude of its phasor is the probability of the object.
    knows_error : whether the expected error of the depth is to be believed.
    """

    title: str
    answer: DepthMap
    light: Reals
    light_name: str
    plan: Plan
    is_probable: bool = True
    knows_error: bool = True

    @property
    def error_cm(self) -> Reals | None:
        """(H, W) expected error of the depth, NaN beside the object; None if it is not known."""
        error_m = self.answer.depth_error_m if self.knows_error else None
        return None if error_m is None else np.where(self.answer.mask, 100 * error_m, np.nan)


@dataclass(frozen=True)
class Scale:
    """Colours and bounds of the panels."""

    light: Colours
    depth: Colours
    error: Colours
    bounds: Bounds

    @classmethod
    def of(cls, views: Sequence[View]) -> Scale:
        """That which shows everything in some views."""
        light = max(float(np.percentile(view.light, _SHOWN_SHARE)) for view in views)
        ranges_m = [depth_range(view.answer) for view in views if view.answer.mask.any()] or [(0.0, 1.0)]
        errors_cm = [view.error_cm for view in views]
        known_cm = [float(np.nanmax(each, initial=0)) for each in errors_cm if each is not None]
        bounds = np.array([view.plan.bounds for view in views])
        near_m, far_m = min(low for low, _ in ranges_m), max(high for _, high in ranges_m)
        lowest, highest = bounds[:, :2].min(axis=0).tolist(), bounds[:, 2:].max(axis=0).tolist()
        return cls(
            Colours("inferno", 0.0, light),
            Colours("viridis", near_m, far_m),
            Colours("magma", 0.0, max([_LEAST_ERROR_CM, *known_cm])),
            (*lowest, *highest),
        )


def draw_prediction(view: View, words: str, scale: Scale | None = None) -> Picture:
    """The picture of one image, as RGB.

    Parameters
    ----------
    words : what is said of the image, below the title.
    scale : None for that which fits this view.
    """
    scale, answer = scale or Scale.of([view]), view.answer
    width, height = panel_size(*answer.mask.shape)
    across, down = width + _GAP, HEAD + height + FOOT + _GAP
    plan_size = (round(1.3 * width), 2 * down - HEAD - _GAP)
    page_width = _GAP + 2 * across + plan_size[0] + _GAP
    lines = wrapped(words, page_width - 2 * _GAP)
    top = _GAP + (1 + _LINES) * _LINE
    page = Image.new("RGB", (page_width, top + 2 * down), WHITE)
    pen = ImageDraw.Draw(page)
    for place, line in enumerate((view.title, *lines[:_LINES])):
        pen.text((_GAP, _GAP // 2 + place * _LINE), line, INK, font(TEXT + 2 * (place == 0)))
    depth_m = np.where(answer.mask, answer.radial_depth_m, np.nan)
    sure = "probability of the object" if view.is_probable else "amplitude of the answer"
    panels = (
        (view.light_name, view.light, scale.light, answer.mask),
        (sure, np.minimum(np.abs(answer.phasor), 1.0), Colours("gray", 0, 1), answer.mask),
        ("depth, m", depth_m, scale.depth, None),
        ("expected error of the depth, cm", view.error_cm, scale.error, None),
    )
    for place, (name, values, colours, outline) in enumerate(panels):
        corner = (_GAP + place % 2 * across, top + place // 2 * down)
        draw_panel(page, corner, (width, height), name, values, colours, outline)
    draw_plan(page, (_GAP + 2 * across, top), plan_size, view.plan, scale.bounds, scale.depth)
    return page


_LINES: Final = 3  # of what is said; all pictures of a file have the same size, as a film needs
