"""Depth maps of the mirrored scene: ground truth and predictions, and the EXR files that hold them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from disk.counted import counted
from disk.frequency_text import megahertz
from itof.arrays import Bools, Complex, PixelsOf, Reals
from itof.exr.header import ImageFileError
from itof.exr.image import Image, phasor_channels, read_image, write_image
from itof.light import phasor_of_return
from itof.pinhole import z_from_radial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEPTH_CHANNEL, MASK_CHANNEL, ERROR_CHANNEL = "depth.R", "mask.M", "depth_error.R"


@dataclass(frozen=True)
class DepthMap:
    """Depth and mask of the hidden object, as seen in a mirror at the place of the relay wall.

    Attributes
    ----------
    radial_depth_m : (..., H, W) metres along the ray of each pixel, 0 on background.
    mask : (..., H, W) bool, True on the hidden object.
    phasor : (..., H, W) complex at `frequency_hz`; ground truth has amplitude 1 on the object, else 0.
    frequency_hz : modulation frequency of the phasor, Hz.
    depth_error_m : (..., H, W) absolute error that a network expects of the depth where there is an object,
        metres; None where nothing expects one.

    Source: Caligiuri et al. 2024, sec. 4.1 (the mirror trick); their released code (amplitude 1).
    """

    radial_depth_m: PixelsOf[Reals]
    mask: PixelsOf[Bools]
    phasor: PixelsOf[Complex]
    frequency_hz: float
    depth_error_m: PixelsOf[Reals] | None = None

    @classmethod
    def of_object(
        cls, radial_depth_m: PixelsOf[Reals], mask: PixelsOf[Bools], frequency_hz: float
    ) -> DepthMap:
        """The depth map of a known object, with its phasor of amplitude 1."""
        phasor = np.where(mask, phasor_of_return(radial_depth_m, frequency_hz), 0.0)
        return cls(radial_depth_m, mask, phasor, frequency_hz)

    def __repr__(self) -> str:
        *several, height, width = self.mask.shape
        images = f"{' x '.join(map(str, several))} images of " if several else ""
        size = f"{images}{width} x {height} pixels"
        depth_m = self.radial_depth_m[self.mask]
        at = f", at {depth_m.min():.2f} to {depth_m.max():.2f} m" if depth_m.size else ""
        return (
            f"DepthMap of {size}, with its phasor at {megahertz(self.frequency_hz)}\n"
            f"{counted(depth_m.size, 'pixel')} of an object{at}"
        )

    @property
    def depth(self) -> PixelsOf[Reals]:
        """`radial_depth_m`: (..., H, W) metres *along the ray* of each pixel, 0 on background."""
        return self.radial_depth_m

    def z_depth_m(self, horizontal_fov_deg: float) -> NDArray[np.float64]:
        """(..., H, W) metres along the optical axis, 0 on background."""
        return z_from_radial(self.radial_depth_m, horizontal_fov_deg)

    def __getitem__(self, index: int) -> DepthMap:
        """One of several depth maps (N, H, W)."""
        error_m = None if self.depth_error_m is None else self.depth_error_m[index]
        depth_m, mask, phasor = (values[index] for values in (self.radial_depth_m, self.mask, self.phasor))
        return DepthMap(depth_m, mask, phasor, self.frequency_hz, error_m)

    def _repr_png_(self) -> bytes | None:
        """Picture of one depth map (H, W), for a notebook."""
        from itof.pictures.panels import panel_png

        if self.mask.ndim != 2:
            return None
        return panel_png("depth, m", np.where(self.mask, self.radial_depth_m, np.nan), "viridis")

    def plot(self) -> Figure:
        """Depth and, where it is known, its expected error; a row for each of several images (N, H, W)."""
        from itof.pictures.plots import Panel, plot_panels

        def row(one: DepthMap) -> list[Panel]:
            images = {"depth, m": one.radial_depth_m, "expected error, m": one.depth_error_m}
            seen = {
                name: np.where(one.mask, values, np.nan)
                for name, values in images.items()
                if values is not None
            }
            return [Panel(*each) for each in seen.items()]

        return plot_panels(
            [row(self)] if self.mask.ndim == 2 else [row(self[place]) for place in range(len(self.mask))]
        )

    def channels(self) -> dict[str, NDArray[np.float32]]:
        """EXR channels of one depth map (H, W): ``depth.R``, ``mask.M``, ``itof.<f>MHz.Re`` and ``.Im``, and
        ``depth_error.R`` where an error is expected.
        """
        error_m = self.depth_error_m
        return {
            **({} if error_m is None else {ERROR_CHANNEL: error_m.astype(np.float32)}),
            DEPTH_CHANNEL: self.radial_depth_m.astype(np.float32),
            MASK_CHANNEL: self.mask.astype(np.float32),
            **phasor_channels(self.phasor[..., None], [self.frequency_hz]),
        }

    def write(self, path: str | os.PathLike[str], attributes: Mapping[str, str]) -> None:
        """Write one depth map (H, W) as an EXR file; `OSError` when it cannot be written."""
        write_image(path, self.channels(), attributes)

    @classmethod
    def read(cls, path: str | os.PathLike[str], *, advice: str = "") -> DepthMap:
        """Read an EXR file that `write` has written.

        Parameters
        ----------
        advice : what to do where the file is damaged; it ends the sentence of the error.

        Raises
        ------
        ImageFileError : a file that is missing or damaged, or that holds no depth map; the message names it.
        """
        image = read_image(path, advice=advice)
        try:
            return cls.of_image(image)
        except ImageFileError as error:
            sentence = f"{Path(path)} {error}"
            raise ImageFileError(f"{sentence}: {advice}" if advice else sentence) from None

    @classmethod
    def of_image(cls, image: Image) -> DepthMap:
        """The (H, W) depth map in an image's channels.

        Raises
        ------
        ImageFileError : channels that are missing, phasors at several frequencies, values that are not
            finite, a mask that is not 0 or 1, a negative depth or a negative error.
        """
        try:
            radial_depth_m, mask = image.channel(DEPTH_CHANNEL), image.channel(MASK_CHANNEL)
            phasor, frequencies_hz = image.phasors()  # (H, W, F)
        except ImageFileError as error:
            raise ImageFileError(f"is no depth map ({error})") from None
        if len(frequencies_hz) != 1:
            raise ImageFileError(f"is no depth map (it has phasors at {len(frequencies_hz)} frequencies)")
        error_m = image.channels.get(ERROR_CHANNEL)
        there = [values for values in (radial_depth_m, mask, phasor, error_m) if values is not None]
        bad = sum(int(np.count_nonzero(~np.isfinite(values))) for values in there)
        if bad:
            raise ImageFileError(f"holds {bad} values that are NaN or infinite")
        if not _is_mask(mask) or (radial_depth_m < 0).any() or (error_m is not None and (error_m < 0).any()):
            raise ImageFileError(
                f"is no depth map: it needs {MASK_CHANNEL} of 0 and 1 and {DEPTH_CHANNEL} from 0 m"
            )
        return cls(radial_depth_m, mask > 0, phasor[..., 0], frequencies_hz[0], error_m)


def _is_mask(values: ArrayLike) -> bool:
    return bool(np.isin(values, (0.0, 1.0)).all())
