"""Draws the pictures of a movie: the frame in false colours, a label, and a curve of the light over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

# From the darkest to the brightest colour. The hidden return is 4 to 5 decades below the direct one
# (docs/science/design.md, Hidden signal is small).
DECADES = 6.0
_BRIGHTEN = 0.75  # exponent on the logarithmic scale that makes the hidden return brighter
_STRIP, _MARGIN = 96, 8  # pixels: height of the curve below the frame, and margin around the curve and labels
Frames = NDArray[np.float32]  # (N, H, W)


@dataclass(frozen=True)
class Span:
    """Bins and pixels of a movie.

    Attributes
    ----------
    start, stop : first bin, and the bin after the last.
    step : bins that are added up in a frame.
    shrink : side of the square of image pixels that are averaged to one pixel of a frame.
    """

    start: int
    stop: int
    step: int
    shrink: int

    @property
    def frames(self) -> int:
        """Number of frames."""
        return -(-(self.stop - self.start) // self.step)


def draw_pictures(
    frames: Frames, total: NDArray[np.float64], span: Span, layout: TransientLayout, min_width: int
) -> Iterator[Picture]:
    """Pictures of all frames, in colours, enlarged and labelled.

    Parameters
    ----------
    frames : (N, H, W) radiance of each frame.
    total : (T,) sum over all pixels of each bin, for the curve.
    min_width : narrower frames are enlarged by an integer factor, pixels.
    """
    from matplotlib import colormaps
    from PIL import Image, ImageDraw, ImageFont

    colours = (colormaps["inferno"](np.linspace(0, 1, 256))[:, :3] * 255).round().astype(np.uint8)
    height, width = frames.shape[1:]
    scale = max(1, -(-min_width // width))
    size = (width * scale, height * scale)
    strip = _strip(total, span, layout, size[0])
    page = Image.new("RGB", (_even(size[0]), _even(size[1] + _STRIP)))
    font = ImageFont.load_default(18)
    brightest = frames.max()
    for index, frame in enumerate(frames):
        picture = Image.fromarray(colours[_level(frame, brightest)]).resize(size, Image.Resampling.NEAREST)
        first = span.start + index * span.step
        last = min(first + span.step, span.stop)
        page.paste(picture, (0, 0))
        page.paste(strip, (0, size[1]))
        opl_m = layout.start_opl_m + np.mean([first, last]) * layout.bin_width_m
        pen = ImageDraw.Draw(page)
        x = _MARGIN + (index + 0.5) / span.frames * (size[0] - 2 * _MARGIN)
        pen.line([(x, size[1] + _MARGIN), (x, size[1] + _STRIP - _MARGIN)], fill=(255, 255, 255), width=2)
        pen.text(
            (_MARGIN, _MARGIN),
            f"optical path length {opl_m:.2f} m",
            font=font,
            fill=(255, 255, 255),
            stroke_width=2,
            stroke_fill=(0, 0, 0),
        )
        yield page.copy()


def _level(values: NDArray[np.floating], brightest: float) -> NDArray[np.uint8]:
    """Index into 256 colours: 255 at the brightest value, 0 at `DECADES` below it and less."""
    with np.errstate(divide="ignore"):
        share = 1 + np.log10(values / brightest) / DECADES
    level: NDArray[np.uint8] = (np.clip(share, 0, 1) ** _BRIGHTEN * 255).round().astype(np.uint8)
    return level


def _strip(total: NDArray[np.float64], span: Span, layout: TransientLayout, width: int) -> Picture:
    """The curve below the frame: light of all pixels over optical path length, on the logarithmic scale."""
    from PIL import Image, ImageDraw, ImageFont

    strip = Image.new("RGB", (width, _STRIP), (24, 24, 28))
    pen = ImageDraw.Draw(strip)
    sums = np.add.reduceat(total[span.start : span.stop], np.arange(0, span.stop - span.start, span.step))
    heights = np.interp(
        np.linspace(0, len(sums) - 1, width - 2 * _MARGIN),
        np.arange(len(sums)),
        _level(sums, sums.max()) / 255,
    )
    foot = _STRIP - _MARGIN
    for column, share in enumerate(heights):
        pen.line(
            [(_MARGIN + column, foot), (_MARGIN + column, foot - share * (foot - _MARGIN))], (96, 96, 160)
        )
    ends = [layout.start_opl_m + bins * layout.bin_width_m for bins in (span.start, span.stop)]
    font = ImageFont.load_default(13)
    pen.text((_MARGIN + 4, foot - 4), f"{ends[0]:.2f} m", font=font, fill=(220, 220, 220), anchor="ls")
    right = width - _MARGIN - 4
    pen.text((right, foot - 4), f"{ends[1]:.2f} m", font=font, fill=(220, 220, 220), anchor="rs")
    pen.text((right, _MARGIN), "light of all pixels (log)", font=font, fill=(220, 220, 220), anchor="rt")
    return strip


def _even(side: int) -> int:
    """The next even number: yuv420p stores colours for blocks of 2 x 2 pixels."""
    return side + side % 2
