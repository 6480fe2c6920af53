"""A film for time-resolved pixels that keeps what a hidden signal of 0.2 % needs.

mitransient's ``transient_hdr_film`` stores the whole image even when cropped, an unused weight channel, and
puts every return into one bin. This one stores the crop alone, one float per bin, and splits every return
linearly between the two nearest bin centres (a tent), so that Φ x has a phase error of 1e-5 instead of 6e-3
rad at 60 MHz (docs/design.md, Time bins).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import mitsuba as mi

FILM_PLUGIN = "night_transient_film"


@cache
def register_film(variant: str) -> None:
    """Make the plugin ``night_transient_film`` known to Mitsuba under the active `variant`.

    Its parameters are those of ``transient_hdr_film``. A function rather than an import, because both
    Mitsuba's and mitransient's classes exist only once a variant is set.
    """
    import drjit as dr
    import mitsuba as mi
    from mitransient.films.transient_hdr_film import TransientHDRFilm

    from render.transport.kernels import TimeAxis, splat_tent

    class TransientFilm(TransientHDRFilm):
        """Crop-sized, single-channel, tent-splatting transient film (mono variants)."""

        def prepare_transient_(self, aovs: Sequence[str]) -> int:
            size = self.crop_size()
            self.shape = (int(size.y), int(size.x), int(self.temporal_bins))
            self.energy = dr.zeros(mi.Float, self.shape[0] * self.shape[1] * self.shape[2])
            self.axis = TimeAxis(int(self.temporal_bins), float(self.bin_width_opl), float(self.start_opl))
            self.channels = ["L"]
            return 1

        def clear(self) -> None:
            self.steady.clear()
            self.energy = dr.zeros(mi.Float, dr.width(self.energy))

        def develop_transient_(self, raw: bool = False) -> mi.TensorXf:
            return mi.TensorXf(self.energy, self.shape)

        def add_transient_data(
            self,
            pos: mi.Vector2f,
            distance: mi.Float,
            wavelengths: mi.UnpolarizedSpectrum,
            spec: mi.Spectrum,
            ray_weight: mi.Spectrum,
            active: mi.Bool,
            **_unused: object,
        ) -> None:
            height, width, _ = self.shape
            column = mi.Int32(pos.x) - int(self.crop_offset().x)
            row = mi.Int32(pos.y) - int(self.crop_offset().y)
            inside = active & (column >= 0) & (column < width) & (row >= 0) & (row < height)
            energy = dr.select(inside, (spec * ray_weight).x, 0)
            first = mi.UInt32(row * width + column) * self.axis.count
            splat_tent(self.energy, first, self.axis, distance, energy, dr.ReduceMode.Auto)

    make: Callable[[Any], Any] = TransientFilm
    mi.register_film(FILM_PLUGIN, make)
