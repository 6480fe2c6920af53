"""OpenEXR files of transients and of images (phasors, depth maps). Only this module imports OpenEXR.

Layout (docs/files.md has the reasons):

* transient: one FLOAT channel ``transient.Y``. Scanline y has the W pixels of image row y in order, each with
  its T bins in time order. The file has H scanlines of W·T values, and any block of rows can be written or
  read by itself. Attributes ``night.bin_count``, ``night.bin_width_m``, ``night.start_opl_m``.
* image: named FLOAT channels of H x W. Phasors are ``<prefix>.<f>MHz.Re`` and ``.Im``.

Both have lossless compression (ZIPS: one scanline per block) and float32 values. Every attribute is text:
OpenEXR would store a number as float32, and 0.01 would be read as 0.00999999978.

Writers write to the final path. Use `scenegen.whole_file` where an incomplete file must not appear.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from types import TracebackType
from typing import Any

import Imath
import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray

from itof.measurement import MeasurementMatrix

TRANSIENT_CHANNEL = "transient.Y"
ATTRIBUTE_PREFIX = "night."
_AXIS = ("bin_count", "bin_width_m", "start_opl_m")  # attributes that every transient has
_FLOAT = Imath.PixelType(Imath.PixelType.FLOAT)
_PHASOR_CHANNEL = re.compile(r"^(?P<prefix>\w+)\.(?P<mhz>\d+(?:\.\d+)?)MHz\.(?P<part>Re|Im)$")
_READ_BYTES = 64 * 2**20  # a row block of this size reads at full speed (docs/design.md, Transient files)


class ImageFileError(ValueError):
    """An image file that is missing, damaged, of another program, or against its layout."""


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
        if min(self.width, self.height, self.bin_count) < 1 or not self.bin_width_m > 0:
            raise ValueError(f"a transient has at least one pixel and one bin, got {self}")

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

    Raises
    ------
    OSError : the file cannot be written.
    ValueError : a block of the wrong shape, or too many or too few rows.
    """

    def __init__(
        self, path: str | os.PathLike[str], layout: TransientLayout, attributes: Mapping[str, str]
    ) -> None:
        self.layout = layout
        self._row = 0
        axis = {name: repr(getattr(layout, name)) for name in _AXIS}
        size = (layout.width * layout.bin_count, layout.height)
        header = _header(size, [TRANSIENT_CHANNEL], {**attributes, **axis})
        self._file = OpenEXR.OutputFile(str(Path(path)), header)

    def write_rows(self, block: ArrayLike) -> None:
        """Append image rows: (rows, W, T), stored as float32."""
        rows = np.ascontiguousarray(block, dtype=np.float32)
        if rows.ndim != 3 or rows.shape[1:] != (self.layout.width, self.layout.bin_count):
            raise ValueError(
                f"expected rows of {self.layout.width} pixels x {self.layout.bin_count} bins, "
                f"got {rows.shape}"
            )
        if self._row + len(rows) > self.layout.height:
            raise ValueError(f"row {self._row + len(rows)} is past the image's {self.layout.height} rows")
        if len(rows):
            self._file.writePixels({TRANSIENT_CHANNEL: rows.tobytes()}, len(rows))
        self._row += len(rows)

    def __enter__(self) -> TransientWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if kind is None and self._row != self.layout.height:
            raise ValueError(f"only {self._row} of {self.layout.height} image rows were written")


class TransientReader:
    """Reads a transient in blocks of image rows; use it as a context manager.

    Attributes
    ----------
    layout : shape and time axis.
    attributes : provenance, text by name.

    Raises
    ------
    ImageFileError : the file is missing, damaged, or not a transient.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with _one_sentence(self.path):
            self._file = _open(self.path)
            header = self._file.header()
        self.attributes = _attributes(header)
        missing = [name for name in _AXIS if name not in self.attributes]
        if TRANSIENT_CHANNEL not in header["channels"] or missing:
            raise ImageFileError(
                f"{path} is an EXR file but not a transient: it needs the channel {TRANSIENT_CHANNEL} and "
                f"the attributes night.bin_count, night.bin_width_m and night.start_opl_m"
            )
        window = header["dataWindow"]
        values = window.max.x - window.min.x + 1  # of a scanline
        try:
            bin_count = int(self.attributes["bin_count"])
            self.layout = TransientLayout(
                width=values // bin_count,
                height=window.max.y - window.min.y + 1,
                bin_count=bin_count,
                bin_width_m=float(self.attributes["bin_width_m"]),
                start_opl_m=float(self.attributes["start_opl_m"]),
            )
        except (ValueError, ZeroDivisionError) as error:
            raise ImageFileError(f"{path} has an impossible time axis: {error}") from None
        if values % bin_count:
            raise ImageFileError(f"{path} has {values} values in a row: no whole pixels of {bin_count} bins")
        self._first_row = window.min.y

    def read_rows(self, start: int, stop: int) -> NDArray[np.float32]:
        """Image rows `start` to `stop` - 1 as (rows, W, T) float32."""
        if not 0 <= start < stop <= self.layout.height:
            raise ValueError(f"rows {start}..{stop} are not within the image's {self.layout.height} rows")
        with _one_sentence(self.path):
            first = self._first_row + start
            data = self._file.channel(TRANSIENT_CHANNEL, _FLOAT, first, first + stop - start - 1)
            rows = np.frombuffer(data, np.float32)
            return rows.reshape(stop - start, self.layout.width, self.layout.bin_count)

    def row_blocks(self, rows: int | None = None) -> Iterator[NDArray[np.float32]]:
        """All image rows in order, as blocks (rows, W, T) float32; by default a block has at most 64 MiB."""
        step = rows or self.layout.rows_per_block
        for start in range(0, self.layout.height, step):
            yield self.read_rows(start, min(start + step, self.layout.height))

    def phasors(self, frequencies_hz: Sequence[float]) -> NDArray[np.complex128]:
        """(H, W, F) iToF phasors Φ x of the file; only one block of rows is in memory at a time.

        If the attribute ``night.splat`` is ``tent``, the phasors are divided by the tent's transfer function.
        """
        axis = self.layout
        phi = MeasurementMatrix(
            tuple(frequencies_hz),
            axis.bin_count,
            axis.bin_width_m,
            axis.start_opl_m,
            splat="tent" if self.attributes.get("splat") == "tent" else "point",
        )
        return phi.apply_streaming(self.row_blocks())

    def __enter__(self) -> TransientReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()


@dataclass(frozen=True)
class Image:
    """Named (H, W) float32 channels with text attributes."""

    channels: dict[str, NDArray[np.float32]]
    attributes: dict[str, str]

    def channel(self, name: str) -> NDArray[np.float32]:
        """(H, W) values of a channel; when it is missing, an `ImageFileError` names the existing ones."""
        if name not in self.channels:
            raise ImageFileError(f"no channel {name} among {', '.join(sorted(self.channels))}")
        return self.channels[name]

    def phasors(self, prefix: str = "itof") -> tuple[NDArray[np.complex64], tuple[float, ...]]:
        """(H, W, F) phasors whose channels have this prefix, and their F frequencies, Hz, ascending."""
        found = [match for name in self.channels if (match := _PHASOR_CHANNEL.match(name))]
        labels = sorted({m["mhz"] for m in found if m["prefix"] == prefix}, key=float)
        if not labels:
            raise ImageFileError(f"no channel {prefix}.<f>MHz.Re/Im among {', '.join(sorted(self.channels))}")
        parts = [
            self.channel(f"{prefix}.{mhz}MHz.Re") + 1j * self.channel(f"{prefix}.{mhz}MHz.Im")
            for mhz in labels
        ]
        return np.stack(parts, axis=-1).astype(np.complex64), tuple(float(f"{mhz}e6") for mhz in labels)


def phasor_channels(
    phasor: ArrayLike, frequencies_hz: Sequence[float], prefix: str = "itof"
) -> dict[str, NDArray[np.float32]]:
    """Channels ``<prefix>.<f>MHz.Re`` and ``.Im`` of (H, W, F) phasors, each (H, W) float32.

    <f> is the shortest exact decimal of the frequency in MHz, so that every frequency is read back exactly.
    """
    z = np.asarray(phasor)
    channels: dict[str, NDArray[np.float32]] = {}
    for index, frequency_hz in enumerate(frequencies_hz):
        label = f"{prefix}.{_megahertz(frequency_hz)}MHz"
        channels[f"{label}.Re"] = z[..., index].real.astype(np.float32)
        channels[f"{label}.Im"] = z[..., index].imag.astype(np.float32)
    return channels


def _megahertz(frequency_hz: float) -> str:
    """20e6 as "20", 62.5e6 as "62.5": decimal digits, which division by a float 1e6 would not keep."""
    digits = format(Decimal(repr(float(frequency_hz))).scaleb(-6), "f")
    return digits.rstrip("0").rstrip(".") if "." in digits else digits


def write_image(
    path: str | os.PathLike[str], channels: Mapping[str, ArrayLike], attributes: Mapping[str, str]
) -> None:
    """Write named (H, W) channels as float32.

    Raises
    ------
    OSError : the file cannot be written.
    ValueError : channels of different shapes, or not of two dimensions.
    """
    pixels = {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in channels.items()}
    shapes = {values.shape for values in pixels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ValueError(f"all channels of an image have one shape (H, W), got {sorted(shapes)}")
    height, width = next(iter(shapes))
    file = OpenEXR.OutputFile(str(Path(path)), _header((width, height), list(pixels), attributes))
    try:
        file.writePixels({name: values.tobytes() for name, values in pixels.items()}, height)
    finally:
        file.close()


def read_image(path: str | os.PathLike[str]) -> Image:
    """Read all channels of an EXR image as (H, W) float32.

    Raises
    ------
    ImageFileError : the file is missing, damaged, or not an EXR file.
    """
    path = Path(path)
    with _one_sentence(path), closing(_open(path)) as file:
        header = file.header()
        window = header["dataWindow"]
        shape = (window.max.y - window.min.y + 1, window.max.x - window.min.x + 1)
        names = list(header["channels"])
        channels = {
            name: np.frombuffer(values, np.float32).reshape(shape)
            for name, values in zip(names, file.channels(names, _FLOAT), strict=True)
        }
    return Image(channels, _attributes(header))


def pixel_types(path: str | os.PathLike[str]) -> dict[str, str]:
    """Number type of each channel of an EXR file, by name: ``FLOAT``, ``HALF`` or ``UINT``.

    Raises
    ------
    ImageFileError : the file is missing or not an EXR file.
    """
    with _one_sentence(Path(path)), closing(_open(Path(path))) as file:
        channels = file.header()["channels"]
    return {name: str(channel.type) for name, channel in channels.items()}


def _header(size: tuple[int, int], channels: Sequence[str], attributes: Mapping[str, str]) -> dict[str, Any]:
    header: dict[str, Any] = OpenEXR.Header(*size)
    header["channels"] = {name: Imath.Channel(_FLOAT) for name in channels}
    header["compression"] = Imath.Compression(Imath.Compression.ZIPS_COMPRESSION)
    return header | {ATTRIBUTE_PREFIX + name: text.encode() for name, text in attributes.items()}


def _attributes(header: Mapping[str, Any]) -> dict[str, str]:
    return {
        name.removeprefix(ATTRIBUTE_PREFIX): value.decode()
        for name, value in header.items()
        if name.startswith(ATTRIBUTE_PREFIX) and isinstance(value, bytes)
    }


def _open(path: Path) -> Any:
    """An open file; `File` refuses names that are not UTF-8, on which `InputFile` crashes the process."""
    header = OpenEXR.File(str(path), header_only=True).header()
    "".join(channel.name for channel in header.get("channels", ()))
    return OpenEXR.InputFile(str(path))


@contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    """Turn OpenEXR's errors into an `ImageFileError` of one sentence, and suppress what it prints."""
    if not path.is_file():
        raise ImageFileError(f"{path} does not exist")
    with tempfile.TemporaryFile() as chatter:
        kept = os.dup(2)
        os.dup2(chatter.fileno(), 2)
        try:
            yield
        except (OSError, RuntimeError, TypeError, ValueError) as error:
            raise ImageFileError(
                f"{path} is damaged or no EXR file ({str(error).strip()}): delete it and make it again"
            ) from None
        finally:
            os.dup2(kept, 2)
            os.close(kept)
