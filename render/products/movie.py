"""Light in motion: a film of a transient: the wavefront crosses the wall, then the hidden object answers.

The hidden return is several thousand times fainter per time bin than the direct one, so brightness is
logarithmic, and a curve below the picture shows when how much light arrives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout, TransientReader
from render.products.conversion import ExportError, exported_file

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

# From black to the brightest: the hidden return is 4 to 5 decades below the direct one (docs/design.md,
# Hidden signal is small).
DECADES = 6.0
_BRIGHTEN = 0.75  # exponent on the logarithmic scale, which lifts the hidden return out of the dark
_MOST_BYTES = 256 * 2**20  # of all frames as float32, before they are drawn
_MOST_PIXELS_WIDE, _NARROWEST = 1280, 240  # the label is 230 pixels wide
_STRIP, _MARGIN = 96, 8  # pixels: height of the curve below the picture, and what is kept clear around it
Frames = NDArray[np.float32]  # (N, H, W)


@dataclass(frozen=True)
class MovieOptions:
    """How long and how large a film is.

    Attributes
    ----------
    max_frames : the film has at most so many; each adds up a whole number of bins.
    frames_per_second : of the film.
    min_width : narrower images are enlarged by a whole factor, pixels.
    """

    max_frames: int = 250
    frames_per_second: int = 20
    min_width: int = 480

    def __post_init__(self) -> None:
        if min(self.max_frames, self.frames_per_second) < 1 or self.min_width < _NARROWEST:
            raise ExportError(
                f"a film has at least 1 frame, 1 frame a second and a width of {_NARROWEST}, got {self}"
            )


@dataclass(frozen=True)
class _Span:
    """Bins start..stop-1, `step` to a frame; pixels are averaged over `shrink` x `shrink`."""

    start: int
    stop: int
    step: int
    shrink: int

    @property
    def frames(self) -> int:
        return -(-(self.stop - self.start) // self.step)


def write_movie(transient: TransientReader | Path, out: Path, options: MovieOptions | None = None) -> None:
    """Film a transient from its first to its last light, as MP4 (H.264) or, where `out` ends so, as GIF.

    A frame is the light of a few bins; its colour is the logarithm of the radiance, over six decades below
    the brightest pixel of any frame. The label is the optical path length (projector to camera, metres) at
    the frame's middle. Below stands the light of all pixels over optical path length, logarithmic too.

    The file is read twice, in blocks of rows; frames are kept as float32, in at most 256 MiB: of longer or
    larger transients, a frame adds up more bins, and images wider than 1280 pixels are averaged down.

    Parameters
    ----------
    transient : an open transient file, or its path.
    out : the film; ``.mp4`` or ``.gif``.

    Raises
    ------
    ExportError : another ending of `out`, a transient without light, or a file that cannot be written.
    ImageFileError : the transient is missing or damaged.
    """
    if out.suffix.lower() not in (".mp4", ".gif"):
        raise ExportError(f"a film is an .mp4 or a .gif file: cannot write {out}")
    if isinstance(transient, Path):
        with TransientReader(transient) as reader:
            write_movie(reader, out, options)
        return
    chosen = options or MovieOptions()
    peak, total = _light_per_bin(transient)
    if not peak.max() > 0:
        raise ExportError(f"{transient.path} holds no light: there is nothing to film")
    span = _lit_span(peak, transient.layout, chosen)
    pictures = _draw(_binned(transient, span), total, span, transient.layout, chosen)
    with exported_file(out) as partial:
        if out.suffix.lower() == ".gif":
            _encode_gif(partial, pictures, chosen)
        else:
            _encode_mp4(partial, pictures, chosen)


def _light_per_bin(reader: TransientReader) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(T,) brightest pixel of every bin, and the sum over pixels."""
    peak = np.zeros(reader.layout.bin_count)
    total = np.zeros(reader.layout.bin_count)
    for rows in reader.row_blocks():
        if not np.isfinite(rows).all():
            raise ExportError(f"{reader.path} holds NaN or infinity: render it again")
        peak = np.maximum(peak, rows.max(axis=(0, 1)))
        total += rows.sum(axis=(0, 1), dtype=np.float64)
    return peak, total


def _lit_span(peak: NDArray[np.float64], layout: TransientLayout, options: MovieOptions) -> _Span:
    """From the first to the last bin that shows, and how many bins and pixels go into one."""
    lit = np.flatnonzero(peak > peak.max() * 10**-DECADES)
    start, stop = max(0, int(lit[0]) - 1), min(layout.bin_count, int(lit[-1]) + 2)  # a dark bin at each end
    shrink = -(-layout.width // _MOST_PIXELS_WIDE)
    frame_bytes = 4 * -(-layout.width // shrink) * -(-layout.height // shrink)
    most = max(1, min(options.max_frames, _MOST_BYTES // frame_bytes))
    return _Span(start, stop, -(-(stop - start) // most), shrink)


def _binned(reader: TransientReader, span: _Span) -> Frames:
    """(N, H, W) sums over the bins of each frame, averaged over the pixels that become one."""
    shape = tuple(-(-side // span.shrink) for side in (reader.layout.height, reader.layout.width))
    frames = np.zeros((span.frames, *shape), np.float32)
    edges = np.arange(0, span.stop - span.start, span.step)
    width, height = reader.layout.width, reader.layout.height
    columns = np.arange(0, width, span.shrink)
    row = 0
    for rows in reader.row_blocks():
        sums = np.add.reduceat(rows[..., span.start : span.stop], edges, axis=-1)  # (rows, W, N)
        sums = np.add.reduceat(sums, columns, axis=1)
        for image_row in sums:
            frames[:, row // span.shrink] += image_row.T
            row += 1
    wide = np.diff(columns, append=width)
    high = np.diff(np.arange(0, height, span.shrink), append=height)
    frames /= np.outer(high, wide).astype(np.float32)  # pixels that became one; fewer at the far edges
    return frames


def _draw(
    frames: Frames, total: NDArray[np.float64], span: _Span, layout: TransientLayout, options: MovieOptions
) -> Iterator[Picture]:
    """Coloured, enlarged and labelled pictures, one after the other."""
    from matplotlib import colormaps
    from PIL import Image, ImageDraw, ImageFont

    colours = (colormaps["inferno"](np.linspace(0, 1, 256))[:, :3] * 255).round().astype(np.uint8)
    height, width = frames.shape[1:]
    scale = max(1, -(-options.min_width // width))
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
        # The mean of both ends of the frame's bins.
        opl_m = layout.start_opl_m + np.mean([first, last]) * layout.bin_width_m
        pen = ImageDraw.Draw(page)
        x = _MARGIN + (index + 0.5) / span.frames * (size[0] - 2 * _MARGIN)  # margins left and right
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
    """Index into 256 colours: 0 at `DECADES` below the brightest and less, 255 at the brightest."""
    with np.errstate(divide="ignore"):
        share = 1 + np.log10(values / brightest) / DECADES
    level: NDArray[np.uint8] = (np.clip(share, 0, 1) ** _BRIGHTEN * 255).round().astype(np.uint8)
    return level


def _strip(total: NDArray[np.float64], span: _Span, layout: TransientLayout, width: int) -> Picture:
    """The light of all pixels over optical path length, logarithmic, as an area below the picture."""
    from PIL import Image, ImageDraw, ImageFont

    strip = Image.new("RGB", (width, _STRIP), (24, 24, 28))
    pen = ImageDraw.Draw(strip)
    sums = np.add.reduceat(total[span.start : span.stop], np.arange(0, span.stop - span.start, span.step))
    heights = np.interp(
        np.linspace(0, len(sums) - 1, width - 2 * _MARGIN),  # margins left and right
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
    return side + side % 2  # H.264 with yuv420p halves the colours' resolution


def _encode_mp4(path: Path, pictures: Iterator[Picture], options: MovieOptions) -> None:
    from imageio_ffmpeg import get_ffmpeg_exe

    first = next(pictures)
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{first.width}x{first.height}"]
    h264 = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-movflags", "+faststart", "-f", "mp4"]
    encoded = [*h264, f"file:{path}"]  # a name with a colon in it is no protocol
    command = [get_ffmpeg_exe(), "-v", "error", "-y", *raw, "-r", str(options.frames_per_second), "-i", "-"]
    # imageio_ffmpeg's own writer neither says whether ffmpeg succeeded nor closes its pipes.
    with TemporaryFile() as complaint:
        try:
            # The program that imageio_ffmpeg brings along; of ours are only numbers and the file's name.
            with Popen([*command, *encoded], stdin=PIPE, stdout=DEVNULL, stderr=complaint) as ffmpeg:  # noqa: S603
                try:
                    for picture in chain([first], pictures):
                        ffmpeg.stdin.write(picture.tobytes())  # type: ignore[union-attr]
                except BaseException:
                    ffmpeg.kill()
                    raise
        except BrokenPipeError:
            pass  # it ended early; why, it has said
        complaint.seek(0)
        reason = " ".join(complaint.read().decode(errors="replace").split())
    if ffmpeg.returncode != 0:
        raise ExportError(
            f"ffmpeg could not encode the film: {reason or f'it ended with code {ffmpeg.returncode}'}"
        )


def _encode_gif(path: Path, pictures: Iterator[Picture], options: MovieOptions) -> None:
    first = next(pictures)
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=pictures,
        duration=round(1000 / options.frames_per_second),
        loop=0,
    )
