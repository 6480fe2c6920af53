"""Transient files: bins over time for every pixel, written and read in blocks of image rows.

One FLOAT channel ``transient.Y``. Scanline y has the W pixels of image row y in order, each with its K stored
bins in time order. The file has H scanlines of W·K values, and any block of rows can be written or read by
itself. The K bins begin at ``night.first_bin`` of the T bins of the time axis; all others are zero. Without
this attribute and ``night.stored_bins``, all T are stored. Attributes ``night.bin_count``,
``night.bin_width_m``, ``night.start_opl_m``. `itof.exr` has the rest.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from disk.machine_memory import memory_shortage
from disk.quantities import BIN_WIDTH
from itof.exr.header import ExrStructure, ImageFileError
from itof.exr.library import ExrInput, ExrOutput
from itof.measurement import MeasurementMatrix
from itof.splat import SPLATS, Splat

TRANSIENT_CHANNEL = "transient.Y"
_AXIS = ("bin_count", "bin_width_m", "start_opl_m")  # attributes that every transient has
_STORED = ("first_bin", "stored_bins")
# In the Python module of OpenEXR, the place of a row in the image, in bytes, is an int. Beyond it, writing
# crashes the process (OpenEXR 3.5.3); reading does not.
MOST_WRITTEN_BYTES = 2**31 - 1
_COPIES = 3  # of a block: also as float64; of the phasors: in blocks, joined, and for what follows
_MOST_M = 1e12
_MOST_BINS = 10_000_000  # as in presets; phasors need numbers for every bin
_READ_BYTES = 64 * 2**20  # such a row block reads at full speed (docs/science/design.md, Transient files)


@dataclass(frozen=True)
class TransientLayout:
    """Shape and time axis of a transient file.

    Attributes
    ----------
    width, height : image size, pixels.
    bin_count : T, number of time bins.
    bin_width_m, start_opl_m : time axis in *optical path length* (out and back), metres.
    """

    width: int
    height: int
    bin_count: int
    bin_width_m: float
    start_opl_m: float

    def __post_init__(self) -> None:
        if min(self.width, self.height, self.bin_count) < 1:
            raise ValueError(f"a transient has at least one pixel and one bin, got {self}")
        if problem := BIN_WIDTH.problem(self.bin_width_m):
            raise ValueError(f"bin_width_m {problem}")
        if not math.isfinite(self.start_opl_m):
            raise ValueError(f"the time axis of a transient begins at a finite length, got {self}")
        if max(abs(self.start_opl_m), self.bin_count * self.bin_width_m) > _MOST_M:
            raise ValueError(f"the time axis of a transient has lengths of at most {_MOST_M:g} m, got {self}")

    @property
    def raw_bytes(self) -> int:
        """Size of all values as float32, before compression."""
        return 4 * self.width * self.height * self.bin_count

    def cut(self, bins: range) -> TransientLayout:
        """The same with these bins alone."""
        start_m = self.start_opl_m + bins.start * self.bin_width_m
        return replace(self, bin_count=len(bins), start_opl_m=start_m)

    @property
    def rows_per_block(self) -> int:
        """Number of image rows in a block of at most 64 MiB; at least 1."""
        return max(1, _READ_BYTES // (4 * self.width * self.bin_count))


class TransientWriter:
    """Writes a transient in blocks of image rows; use it as a context manager.

    Parameters
    ----------
    path : file to write.
    layout : shape and time axis.
    attributes : provenance, text by name; the file's names have the prefix ``night.``.
    bins : the bins to store; all others are zero. None: all.

    Raises
    ------
    OSError : the file cannot be written.
    ValueError : the transient has more than `MOST_WRITTEN_BYTES`, a block has the wrong shape, or there are
        too many or too few rows.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        layout: TransientLayout,
        attributes: Mapping[str, str],
        bins: range | None = None,
    ) -> None:
        if layout.raw_bytes > MOST_WRITTEN_BYTES:
            raise ValueError(
                f"a transient of {layout.raw_bytes} bytes is too large: OpenEXR writes at most "
                f"{MOST_WRITTEN_BYTES}; use fewer bins or pixels"
            )
        self.layout = layout
        self._row = 0
        self._bins = bins or range(layout.bin_count)
        axis = {name: repr(getattr(layout, name)) for name in _AXIS}
        if bins is not None:
            axis |= dict(zip(_STORED, map(str, (bins.start, len(bins))), strict=True))
        size = (layout.width * len(self._bins), layout.height)
        self._file = ExrOutput(Path(path), size, [TRANSIENT_CHANNEL], {**attributes, **axis})

    def write_rows(self, block: ArrayLike) -> None:
        """Append image rows: (rows, W, bins), stored as float32."""
        rows = np.ascontiguousarray(block, dtype=np.float32)
        if rows.ndim != 3 or rows.shape[1:] != (self.layout.width, len(self._bins)):
            raise ValueError(
                f"expected rows of {self.layout.width} pixels x {len(self._bins)} bins, got {rows.shape}"
            )
        if self._row + len(rows) > self.layout.height:
            raise ValueError(f"row {self._row + len(rows)} is past the image's {self.layout.height} rows")
        if len(rows):
            self._file.write({TRANSIENT_CHANNEL: rows}, len(rows))
        self._row += len(rows)

    def __enter__(self) -> TransientWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close(complete=kind is None and self._row == self.layout.height)
        if kind is None and self._row != self.layout.height:
            raise ValueError(f"only {self._row} of {self.layout.height} image rows were written")


class TransientReader:
    """Reads a transient in blocks of image rows; use it as a context manager.

    Parameters
    ----------
    path : file to read.
    advice : what to do where the file is damaged; it ends the sentence of the error.

    Attributes
    ----------
    layout : shape and time axis.
    bins : the stored bins; all others are zero.
    attributes : provenance, text by name.

    Raises
    ------
    ImageFileError : the file is missing, damaged, or not a transient.
    """

    def __init__(self, path: str | os.PathLike[str], *, advice: str = "") -> None:
        self.path = Path(path)
        self._file = ExrInput(self.path, advice)
        self.attributes = {name: text for name, text in self._file.texts.items() if name not in _STORED}
        try:
            self.layout, self.bins = self._layout(self._file.structure)
        except ImageFileError:
            self._file.close()
            raise

    def _layout(self, found: ExrStructure) -> tuple[TransientLayout, range]:
        missing = [name for name in _AXIS if name not in self.attributes]
        if TRANSIENT_CHANNEL not in found.channels or missing:
            raise self._file.refusal(
                f"{self.path} is an EXR file but not a transient: it needs the channel {TRANSIENT_CHANNEL} "
                "and the attributes night.bin_count, night.bin_width_m and night.start_opl_m"
            )
        try:
            bin_count = int(self.attributes["bin_count"])
            found_bins = zip(_STORED, (0, bin_count), strict=True)
            first, stored = (int(self._file.texts.get(name, all_)) for name, all_ in found_bins)
            layout = TransientLayout(
                width=found.width // stored,
                height=found.height,
                bin_count=bin_count,
                bin_width_m=float(self.attributes["bin_width_m"]),
                start_opl_m=float(self.attributes["start_opl_m"]),
            )
        except (ValueError, ZeroDivisionError) as error:
            raise self._file.refusal(f"{self.path} has an impossible time axis: {str(error)[:200]}") from None
        if not 0 <= first < first + stored <= bin_count:
            raise self._file.refusal(
                f"{self.path} stores the bins {first} to {first + stored}, and its time axis has {bin_count}"
            )
        if bin_count > _MOST_BINS:
            raise self._file.refusal(
                f"{self.path} has {bin_count} time bins, and at most {_MOST_BINS} are read"
            )
        if found.width % stored:
            raise self._file.refusal(
                f"{self.path} has {found.width} values in a row: no whole pixels of {stored} bins"
            )
        block_bytes = layout.raw_bytes // found.height * min(found.height, layout.rows_per_block)
        if shortage := memory_shortage(block_bytes + found.unpacking_bytes, copies=_COPIES):
            raise ImageFileError(f"{self.path} {shortage}")
        return layout, range(first, first + stored)

    @property
    def splat(self) -> Splat:
        """How returns were put into bins, from the attribute ``night.splat``; ``point`` without it.

        Raises
        ------
        ImageFileError : the attribute says something else.
        """
        text = self.attributes.get("splat", "point")
        for known in SPLATS:
            if text == known:
                return known
        raise self._file.refusal(
            f"{self.path} puts returns into bins in an unknown way: night.splat is {text[:50]!r} "
            f"and not one of {', '.join(SPLATS)}"
        )

    def read_rows(self, start: int, stop: int) -> NDArray[np.float32]:
        """Image rows `start` to `stop` - 1 as (rows, W, T) float32."""
        stored = self._stored_rows(start, stop)
        if len(self.bins) == self.layout.bin_count:
            return stored
        rows = np.zeros((*stored.shape[:2], self.layout.bin_count), np.float32)
        rows[..., self.bins.start : self.bins.stop] = stored
        return rows

    def _stored_rows(self, start: int, stop: int) -> NDArray[np.float32]:
        if not 0 <= start < stop <= self.layout.height:
            raise ValueError(f"rows {start}..{stop} are not within the image's {self.layout.height} rows")
        (rows,) = self._file.rows([TRANSIENT_CHANNEL], start, stop)
        return rows.reshape(stop - start, self.layout.width, len(self.bins))

    def row_blocks(self, rows: int | None = None) -> Iterator[NDArray[np.float32]]:
        """All image rows in order, as blocks (rows, W, T) float32; by default a block has at most 64 MiB."""
        step = rows or self.layout.rows_per_block
        for start in range(0, self.layout.height, step):
            yield self.read_rows(start, min(start + step, self.layout.height))

    def phasors(self, frequencies_hz: Sequence[float]) -> NDArray[np.complex128]:
        """(H, W, F) iToF phasors Φ x of the file; only one block of rows is in memory at a time.

        They are divided by the transfer function of the file's `splat`.

        Raises
        ------
        ImageFileError : the file is damaged, or the phasors do not fit into memory.
        """
        axis, stored = self.layout, self.layout.cut(self.bins)
        phasor_bytes = axis.width * axis.height * len(frequencies_hz) * np.dtype(np.complex128).itemsize
        if shortage := memory_shortage(phasor_bytes, copies=_COPIES):
            raise ImageFileError(f"{self.path} {shortage}")
        phi = MeasurementMatrix(
            tuple(frequencies_hz),
            stored.bin_count,
            stored.bin_width_m,
            stored.start_opl_m,
            splat=self.splat,
        )
        step, height = stored.rows_per_block, axis.height
        ranges = ((start, min(start + step, height)) for start in range(0, height, step))
        return phi.apply_streaming(self._stored_rows(*each) for each in ranges)

    def __enter__(self) -> TransientReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
