"""Light in motion: a movie of a transient, in which light crosses the wall and the hidden object returns it.

In a time bin, the hidden return is several thousand times fainter than the direct one, so brightness is
logarithmic. A curve below the picture shows how much light arrives at each time.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import PathLike
from disk.extras import need
from itof import TransientLayout, TransientReader
from itof.pictures.film import encode_film
from render.products.conversion import ExportError, exported_file
from render.products.movie_encoding import encode_mp4
from render.products.movie_pictures import DECADES, Frames, Span, draw_pictures

_MOST_BYTES = 256 * 2**20  # of all frames as float32
_MOST_PIXELS_WIDE, _NARROWEST = 1280, 240  # the label is 230 pixels wide


@dataclass(frozen=True)
class MovieOptions:
    """Length and size of a movie.

    Attributes
    ----------
    max_frames : most frames of the movie; each frame adds up the same number of bins.
    frames_per_second : speed of the movie.
    min_width : narrower images are enlarged by an integer factor, pixels.

    Raises
    ------
    ExportError : a number below its minimum.
    """

    max_frames: int = 250
    frames_per_second: int = 20
    min_width: int = 480

    def __post_init__(self) -> None:
        if min(self.max_frames, self.frames_per_second) < 1 or self.min_width < _NARROWEST:
            raise ExportError(
                f"a movie needs at least 1 frame, 1 frame a second and a width of {_NARROWEST}, got {self}"
            )


def write_movie(
    transient: TransientReader | PathLike, out: PathLike, options: MovieOptions | None = None
) -> None:
    """Write a movie of a transient, from its first to its last light, as MP4 (H.264) or as GIF.

    A frame is the light of a few bins. Its colour is the logarithm of the radiance, over six decades below
    the brightest pixel of all frames. The label is the optical path length from projector to camera at the
    middle of the frame, in metres. The curve below shows the light of all pixels over optical path length,
    on the same logarithmic scale.

    The file is read twice, in blocks of rows. The frames take at most 256 MiB as float32: in a longer or
    larger transient, a frame adds up more bins. Images wider than 1280 pixels are averaged to smaller ones.

    Parameters
    ----------
    transient : an open transient file, or its path.
    out : file to write; its ending ``.mp4`` or ``.gif`` selects the format.
    options : None takes the defaults.

    Raises
    ------
    ExportError : `out` has another ending or cannot be written, or the transient has no light, NaN or
        infinity.
    ImageFileError : the transient is missing or damaged.
    MissingPackageError : `out` is an MP4 file, and the extra ``export`` is not installed.
    """
    out = Path(out)
    if out.suffix.lower() not in (".mp4", ".gif"):
        raise ExportError(f"a movie is an .mp4 or a .gif file: cannot write {out}")
    if out.suffix.lower() == ".mp4":
        need("export", ("imageio_ffmpeg",), "an MP4 movie")
    if not isinstance(transient, TransientReader):
        with TransientReader(transient) as reader:
            write_movie(reader, out, options)
        return
    chosen = options or MovieOptions()
    peak, total = _light_per_bin(transient)
    if not peak.max() > 0:
        raise ExportError(f"{transient.path} holds no light, so no movie can be made of it")
    span = _lit_span(peak, transient.layout, chosen)
    frames = _binned(transient, span)
    pictures = draw_pictures(frames, total, span, transient.layout, chosen.min_width)
    encode = encode_film if out.suffix.lower() == ".gif" else encode_mp4
    with exported_file(out) as partial:
        try:
            encode(partial, pictures, chosen.frames_per_second)
        except ExportError as error:
            raise ExportError(f"cannot write {out}: {error}") from None


def _light_per_bin(reader: TransientReader) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(T,) maximum over pixels of each bin, and (T,) sum over pixels."""
    peak = np.zeros(reader.layout.bin_count)
    total = np.zeros(reader.layout.bin_count)
    for rows in reader.row_blocks():
        if not np.isfinite(rows).all():
            raise ExportError(f"{reader.path} holds NaN or infinity: render it again")
        peak = np.maximum(peak, rows.max(axis=(0, 1)))
        total += rows.sum(axis=(0, 1), dtype=np.float64)
    return peak, total


def _lit_span(peak: NDArray[np.float64], layout: TransientLayout, options: MovieOptions) -> Span:
    """From the first to the last visible bin, with the bins and pixels that become one."""
    lit = np.flatnonzero(peak > peak.max() * 10**-DECADES)
    start, stop = max(0, int(lit[0]) - 1), min(layout.bin_count, int(lit[-1]) + 2)  # a dark bin at each end
    shrink = -(-layout.width // _MOST_PIXELS_WIDE)
    frame_bytes = 4 * -(-layout.width // shrink) * -(-layout.height // shrink)
    most = max(1, min(options.max_frames, _MOST_BYTES // frame_bytes))
    return Span(start, stop, -(-(stop - start) // most), shrink)


def _binned(reader: TransientReader, span: Span) -> Frames:
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
    frames /= np.outer(high, wide).astype(np.float32)  # fewer pixels are averaged at the right and lower edge
    return frames
