"""Method ``path``: path tracing with ``transient_path`` of mitransient, the unbiased reference.

Our changes: returns are split over three bins; rays start at the pinhole, not at the near clip plane; the
projector's frustum is 0.001 degrees wider than the camera's; pixel samples are stratified; paths are added in
float64; NaN stops the render.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from render.options import PathOptions
from render.transport.film.lattice import Lattice
from render.transport.method import LitRows, View
from render.transport.passes.direct_samples import sample_direct
from render.transport.transient_film import FILM_PLUGIN, register_film
from scenegen.mitsuba_description import ROUGH_WALL

if TYPE_CHECKING:
    import mitsuba as mi

INTEGRATOR_PLUGIN = "night_transient_path"
_WAVEFRONT = 2**24  # paths in flight: about 1 GB in DrJit
_SAMPLES_PER_PASS = 1024  # so that the paths in flight are those of several rows
_LOST_ENERGY = 1e-3  # share of the light outside the time axis above which a warning is logged

log = logging.getLogger(__name__)


class PathTracer:
    """Unbiased transient path tracing with next-event estimation.

    The relative error of a hidden pixel is 10 to 15 / sqrt(spp) (docs/science/design.md, Path tracing).

    Parameters
    ----------
    options : the paths per pixel, `spp`, are rounded up to equal passes of at most 1024 paths, each of whole
        strata.
    variant : the active Mitsuba variant.
    """

    name = PathOptions.method
    rough_wall = ROUGH_WALL  # Mitsuba's own

    def __init__(self, options: PathOptions, variant: str) -> None:
        self.passes = -(-options.spp // _SAMPLES_PER_PASS)
        self.spp_per_pass = _whole_strata(-(-options.spp // self.passes))
        register_film(variant)
        _register_integrator(variant)

    def expose(self, scene: mi.Scene, view: View) -> PathExposure:
        """The measurement of a scene; `PathExposure.row_blocks` does all the work."""
        return PathExposure(self.passes, self.spp_per_pass, scene, view)


def _whole_strata(spp: int) -> int:
    """`spp` rounded up to a product of two nearly equal integers: the strata of the multijitter sampler."""
    rows = int(np.sqrt(spp))
    return rows * -(-spp // rows)


@dataclass(frozen=True)
class PathExposure:
    """One measurement by path tracing."""

    passes: int
    spp_per_pass: int
    scene: mi.Scene
    view: View

    @property
    def attributes(self) -> dict[str, str]:
        """Provenance for the file: the number of paths per pixel after rounding up."""
        return {"spp": str(self.passes * self.spp_per_pass)}

    def phasors(self) -> None:
        """None, because the films of mitransient have only time bins."""
        return

    def lit_rows(self) -> LitRows:
        """Image rows of all bins, which noise may fill."""
        return LitRows(range(self.view.layout.bin_count), self.row_blocks())

    def row_blocks(self) -> Iterator[NDArray[np.float32]]:
        """Image rows from top to bottom, in blocks (rows, W, T) of radiance per bin, W m^-2 sr^-1."""
        view = self.view
        step = max(1, _WAVEFRONT // (view.layout.width * self.spp_per_pass))
        step = min(step, view.layout.rows_per_block)
        quantum = _quantum(self.scene, view.seed)
        energy = lost = 0.0
        for start in range(0, view.layout.height, step):
            rows = min(step, view.layout.height - start)
            block, steady = self._render_rows(start, rows, quantum)
            energy += steady
            lost += steady - float(block.sum(dtype=np.float64))
            yield block
        if lost > _LOST_ENERGY * energy:
            log.warning(
                "%.2g %% of the light arrives outside the time axis: raise bin_count or lower start_opl_m",
                100 * lost / energy,
            )

    def _render_rows(self, start: int, rows: int, quantum: float) -> tuple[NDArray[np.float32], float]:
        import drjit as dr
        import mitsuba as mi

        scene, view = self.scene, self.view
        sensor = mi.load_dict(_sensor_dict(scene, view, start, rows, quantum))
        depth = view.max_bounces + 1  # mitransient counts the edges of a path
        integrator = mi.load_dict({"type": INTEGRATOR_PLUGIN, "max_depth": depth})
        total = np.zeros((rows, view.layout.width, view.layout.bin_count))
        steady_sum = 0.0
        for number in range(self.passes):
            seed = np.random.SeedSequence([view.seed, start, number]).generate_state(1)[0]
            # opaque: a literal would compile the kernel again for every seed (docs/science/design.md, DrJit)
            steady, transient = integrator.render(
                scene, sensor, seed=dr.opaque(mi.UInt32, int(seed)), spp=self.spp_per_pass
            )
            dr.eval(steady, transient)
            total += np.array(transient)
            steady_sum += float(np.array(steady).sum(dtype=np.float64))
        return (total / self.passes).astype(np.float32), steady_sum / self.passes


def _quantum(scene: mi.Scene, seed: int) -> float:
    """A power of two near 2^-50 of the brightest direct return: bins of up to 8 times that are exact sums."""
    brightest = float(sample_direct(scene, Lattice(64, 48).nodes, seed).radiance.max())
    return float(2.0 ** (np.ceil(np.log2(brightest)) - 50)) if 0 < brightest < np.inf else 2.0**-50


def _sensor_dict(scene: mi.Scene, view: View, start: int, rows: int, quantum: float) -> dict[str, Any]:
    """The scene's own camera with a transient film that covers `rows` image rows."""
    import mitsuba as mi

    layout = view.layout
    sensor = scene.sensors()[0]
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(mi.traverse(sensor)["x_fov"][0]),
        "to_world": mi.ScalarTransform4f(np.array(sensor.world_transform().matrix).reshape(4, 4)),
        # Stratified, because the direct return varies more within a pixel than the hidden signal is large.
        "sampler": {"type": "multijitter"},
        "film": {
            "type": FILM_PLUGIN,
            "width": layout.width,
            "height": layout.height,
            "crop_offset_x": 0,
            "crop_offset_y": start,
            "crop_width": layout.width,
            "crop_height": rows,
            "temporal_bins": layout.bin_count,
            "bin_width_opl": layout.bin_width_m,
            "start_opl": layout.start_opl_m,
            "quantum": quantum,
            "rfilter": {"type": "box"},
        },
    }


@cache
def _register_integrator(variant: str) -> None:
    """Register ``transient_path`` with optical paths that start at the pinhole.

    Mitsuba starts camera rays at the near clip plane, 1 cm from the pinhole by default, which makes every
    optical path 1 to 1.2 cm too short.
    """
    import mitransient  # noqa: F401  (registers the plugins it subclasses)
    import mitsuba as mi
    from mitransient.integrators.transientpath import TransientPath

    class TransientPathFromPinhole(TransientPath):
        def sample_rays(self, scene: mi.Scene, sensor: mi.Sensor, sampler: mi.Sampler) -> tuple[Any, ...]:
            ray, weight, position = super().sample_rays(scene, sensor, sampler)
            ray.o = sensor.world_transform().translation()
            return ray, weight, position

    mi.register_integrator(INTEGRATOR_PLUGIN, TransientPathFromPinhole)
