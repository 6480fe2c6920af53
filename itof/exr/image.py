"""EXR images with named channels: phasors and depth maps.

Layout (docs/reference/files.md): named FLOAT channels of H x W. Phasors are ``<prefix>.<f>MHz.Re`` and
``.Im``. Transients are in `itof.exr.transient`.

All files have float32 values and lossless compression (ZIPS: one scanline per block), but renders of phasors
have none. Every attribute is text: OpenEXR would store a number as float32, and 0.01 would be read as
0.00999999978.

Writers write to the final path. Use `disk.whole_file` where an incomplete file must not appear.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from disk.frequency_text import exact_megahertz
from disk.machine_memory import memory_shortage
from disk.told import Told
from itof.exr.header import ImageFileError
from itof.exr.library import ExrInput, ExrOutput

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIELD_OF_VIEW = "horizontal_fov_deg"  # attribute of images; an array of other measurement files
PROJECTOR = "projector"  # attribute of measurements whose light is no flash at the camera
_COPIES = 4  # of the channels, while phasors are made of them
_MOST_NAMES = 20  # of channels in a sentence
_PHASOR_CHANNEL = re.compile(r"(?P<prefix>\w+)\.(?P<mhz>[0-9]{1,300}(\.[0-9]{1,300})?)MHz\.(?P<part>Re|Im)")


@dataclass(frozen=True, repr=False)
class Image(Told):
    """Named (H, W) float32 channels with text attributes."""

    channels: dict[str, NDArray[np.float32]]
    attributes: dict[str, str]

    @property
    def sentences(self) -> tuple[str, str]:
        """Its size and its channels."""
        height, width = next(iter(self.channels.values())).shape
        return f"{width} x {height} pixels", f"channels {self._names()}"

    def channel(self, name: str) -> NDArray[np.float32]:
        """(H, W) values of a channel; when it is missing, an `ImageFileError` names the existing ones."""
        if name not in self.channels:
            raise ImageFileError(f"no channel {name} among {self._names()}")
        return self.channels[name]

    def phasors(self, prefix: str = "itof") -> tuple[NDArray[np.complex64], tuple[float, ...]]:
        """(H, W, F) phasors whose channels have this prefix, and their F frequencies, Hz, ascending."""
        found = [match for name in self.channels if (match := _PHASOR_CHANNEL.fullmatch(name))]
        labels = sorted({m["mhz"] for m in found if m["prefix"] == prefix}, key=float)
        if not labels:
            raise ImageFileError(f"no channel {prefix}.<f>MHz.Re/Im among {self._names()}")
        with np.errstate(invalid="ignore"):  # infinite pixels become NaN
            parts = [
                self.channel(f"{prefix}.{mhz}MHz.Re") + 1j * self.channel(f"{prefix}.{mhz}MHz.Im")
                for mhz in labels
            ]
        return np.stack(parts, axis=-1).astype(np.complex64), tuple(float(f"{mhz}e6") for mhz in labels)

    def plot(self) -> Figure:
        """Amplitude and phase of the phasors, a column for each frequency, and the other channels."""
        from itof.pictures.plots import Panel, phasor_panels, plot_panels

        found = [_PHASOR_CHANNEL.fullmatch(name) for name in self.channels]
        prefixes = dict.fromkeys(match["prefix"] for match in found if match)
        rows = [row for each in prefixes for row in phasor_panels(*self.phasors(each), each)]
        others = [name for name, match in zip(self.channels, found, strict=True) if not match]
        return plot_panels([*rows, *([Panel(name, self.channels[name])] for name in others)])

    def _names(self) -> str:
        first = ", ".join(sorted(self.channels)[:_MOST_NAMES])
        return f"{first}, ..." if len(self.channels) > _MOST_NAMES else first


def phasor_channels(
    phasor: ArrayLike, frequencies_hz: Sequence[float], prefix: str = "itof"
) -> dict[str, NDArray[np.float32]]:
    """Channels ``<prefix>.<f>MHz.Re`` and ``.Im`` of (H, W, F) phasors, each (H, W) float32.

    <f> is the shortest exact decimal of the frequency in MHz, so that every frequency is read back exactly.
    """
    z = np.asarray(phasor)
    channels: dict[str, NDArray[np.float32]] = {}
    for index, frequency_hz in enumerate(frequencies_hz):
        label = f"{prefix}.{exact_megahertz(frequency_hz)}MHz"
        channels[f"{label}.Re"] = z[..., index].real.astype(np.float32)
        channels[f"{label}.Im"] = z[..., index].imag.astype(np.float32)
    return channels


def write_image(
    path: str | os.PathLike[str],
    channels: Mapping[str, ArrayLike],
    attributes: Mapping[str, str],
    *,
    packed: bool = True,
) -> None:
    """Write named (H, W) channels as float32.

    Parameters
    ----------
    packed : compressed (ZIPS), or not at all: rows of phasors become 0 to 2 % smaller, for most of the time
        that it takes to write them.

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
    file = ExrOutput(Path(path), (width, height), list(pixels), attributes, packed=packed)
    is_complete = False
    try:
        file.write(pixels, height)
        is_complete = True
    finally:
        file.close(complete=is_complete)


def image_bytes(
    channels: Mapping[str, ArrayLike], attributes: Mapping[str, str], *, packed: bool = True
) -> bytes:
    """What `write_image` writes, so that many images can wait for the disk together.

    OpenEXR writes to files with names only: here to one of Linux that is in memory.
    """
    with os.fdopen(os.memfd_create("image"), "rb") as memory:
        write_image(f"/proc/self/fd/{memory.fileno()}", channels, attributes, packed=packed)
        return memory.read()


def read_image(path: str | os.PathLike[str], *, advice: str = "", copies: int = _COPIES) -> Image:
    """Read all channels of an EXR image as (H, W) float32.

    Parameters
    ----------
    advice : what to do where the file is damaged; it ends the sentence of the error.
    copies : how many copies of the channels must fit into half of the memory; phasors need four.

    Raises
    ------
    ImageFileError : the file is missing, damaged, not an EXR file, or too large for this machine's memory.
    """
    with closing(ExrInput(Path(path), advice)) as file:
        found = file.structure
        if shortage := memory_shortage(found.float_bytes + found.unpacking_bytes, copies=copies):
            raise ImageFileError(f"{path} {shortage}")
        names = list(found.channels)
        return Image(dict(zip(names, file.rows(names, 0, found.height), strict=True)), file.texts)


def pixel_types(path: str | os.PathLike[str]) -> dict[str, str]:
    """Number type of each channel of an EXR file, by name: ``FLOAT``, ``HALF`` or ``UINT``.

    Raises
    ------
    ImageFileError : the file is missing or not an EXR file.
    """
    with closing(ExrInput(Path(path))) as file:
        return file.structure.channels
