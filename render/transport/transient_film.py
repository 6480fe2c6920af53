"""A film for transients, exact enough for a hidden signal of 0.2 % of the total.

For a crop window, ``transient_hdr_film`` of mitransient stores the whole image. It also stores an unused
weight channel and adds every return to one bin. This film stores only the crop window, one number per bin.
It splits every return over the three nearest bins (a quadratic B-spline), which reduces the phase error of
phasors at 60 MHz from 6e-3 to 2e-8 rad (docs/science/design.md, Time bins).
Sums do not depend on the number of threads.
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
    """Register the plugin ``night_transient_film`` with Mitsuba for the active `variant`.

    It has the parameters of ``transient_hdr_film``, and ``quantum``: a power of two to whose multiples all
    returns are rounded, so that their sums are exact. The class is defined in this function, because the base
    classes exist only after a variant is set.
    """
    import drjit as dr
    import mitsuba as mi
    from mitransient.films.transient_hdr_film import TransientHDRFilm

    from render.transport.kernels.time_bins import TimeAxis, splat_quadratic

    class TransientFilm(TransientHDRFilm):
        """Transient film of the crop window with one channel and quadratic splatting, for mono variants."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.quantum = dr.opaque(mi.Float64, float(props["quantum"]))

        def prepare_transient_(self, aovs: Sequence[str]) -> int:
            size = self.crop_size()
            self.shape = (int(size.y), int(size.x), int(self.temporal_bins))
            self.energy = dr.zeros(mi.Float64, self.shape[0] * self.shape[1] * self.shape[2])
            self.axis = TimeAxis(int(self.temporal_bins), float(self.bin_width_opl), float(self.start_opl))
            self.channels = ["L"]
            return 1

        def clear(self) -> None:
            self.steady.clear()
            self.energy = dr.zeros(mi.Float64, dr.width(self.energy))

        def develop_transient_(self, raw: bool = False) -> mi.TensorXf:
            return mi.TensorXf(mi.Float(self.energy), self.shape)

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
            splat_quadratic(self.energy, first, self.axis, distance, energy, self.quantum)

    make: Callable[[Any], Any] = TransientFilm
    mi.register_film(FILM_PLUGIN, make)
