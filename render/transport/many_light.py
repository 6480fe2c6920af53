"""Method ``many-light``: virtual lights on the hidden surface light every pixel over the relay wall.

docs/rendering.md derives the estimator and lists its errors.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.options import ManyLightOptions
from render.transport.gather_pass import (
    Grid,
    PixelRule,
    gather_direct,
    gather_lights,
    gauss_rule,
    midpoint_rule,
    splat_rows,
)
from render.transport.hidden_surface import HiddenSurface, read_hidden_surface
from render.transport.light_pass import Lights, light_density, make_lights, no_lights
from render.transport.method import PhasorImage, View
from render.transport.scene_checks import check_many_light_scene

if TYPE_CHECKING:
    import mitsuba as mi

_FEWEST_WALL_POINTS, _MOST_WALL_POINTS = 32, 256  # for each surface point
_LIGHT_PATHS = 2**18  # surface points times wall points
_DIRECT_RULE = gauss_rule(4)
# Cells of the direct return in a transient: in the width of the image, and their limits in a pixel. Their
# error must be small against a hidden signal of 3e-4, also in large pixels.
_DIRECT_CELLS, _FEWEST_CELLS, _MOST_CELLS = 2560, 16, 64
_PACKETS = 16  # for the arrivals of each light, in a transient
_PILOT = Grid(16, 12)  # pixels that the error is estimated on
_PILOT_RUNS = 4
_FEWEST_LIGHTS, _MOST_LIGHTS = 128, 2**17
_WIDE_PIXEL = 4e-3  # of the image width; the hidden part of wider pixels takes 2 x 2 nodes instead of one

log = logging.getLogger(__name__)


class ManyLight:
    """The method ``many-light``: phasors without time bins, and transients from the same lights.

    Parameters
    ----------
    options : `lights` fixes the number of surface points. Without it, a pilot finds the number that the
        hidden-signal error `error` needs.
    variant : the active Mitsuba variant.
    """

    name = ManyLightOptions.method

    def __init__(self, options: ManyLightOptions, variant: str) -> None:
        self.options = options

    def expose(self, scene: mi.Scene, view: View) -> ManyLightExposure:
        """Make the lights of a scene.

        Raises
        ------
        SceneError, HiddenSurfaceError : this method cannot render the scene; the message says what to do.
        """
        surface = read_hidden_surface(scene) if view.max_bounces >= 3 else None
        if view.max_bounces > 1:
            check_many_light_scene(scene, surface is not None)
        if surface is None:
            return ManyLightExposure(scene, view, no_lights(), None)
        workshop = LightWorkshop(scene, surface, light_density(scene, surface, view.seed), view)
        count, error = self._count_and_error(workshop)
        lights = workshop.lights(count, view.seed, view.max_bounces)
        log.debug("%d surface points became %d lights", count, len(lights))
        return ManyLightExposure(scene, view, lights, error)

    def _count_and_error(self, workshop: LightWorkshop) -> tuple[int, float]:
        """Number of surface points, and the estimated error of the hidden signal with that number."""
        if self.options.lights is not None:
            return self.options.lights, workshop.pilot_error(self.options.lights)
        count = _FEWEST_LIGHTS
        while (error := workshop.pilot_error(count)) > self.options.error:
            if count >= _MOST_LIGHTS:
                log.warning("the hidden-signal error is %.2g even with %d lights", error, count)
                break
            # On a smooth surface, twice the points halve the error, so a large error needs two doublings.
            count *= 4 if error > 8 * self.options.error else 2
        return count, error


@dataclass(frozen=True)
class LightWorkshop:
    """Makes sets of lights for one measurement, for the pilot and for the image."""

    scene: mi.Scene
    surface: HiddenSurface
    density: NDArray[np.float64]
    view: View

    def lights(self, count: int, seed: int, max_bounces: int = 3) -> Lights:
        """Lights at `count` surface points. With more surface points, each needs fewer wall points."""
        wall_points = min(max(_LIGHT_PATHS // count, _FEWEST_WALL_POINTS), _MOST_WALL_POINTS)
        return make_lights(self.scene, self.surface, self.density, count, wall_points, seed, max_bounces)

    def pilot_error(self, count: int) -> float:
        """Relative error ‖z - z̄‖ / ‖z̄‖ of the hidden phasors with `count` surface points.

        It is the standard deviation over four independent scramblings of the points, on 16 x 12 pixels at the
        highest frequency, where the error is largest.
        """
        highest = (max(self.view.frequencies_hz),)
        runs = []
        for run in range(_PILOT_RUNS):
            seed = int(np.random.SeedSequence([self.view.seed, 1, run]).generate_state(1)[0])
            runs.append(gather_lights(self.scene, _PILOT, highest, gauss_rule(1), self.lights(count, seed)))
        z = np.array(runs)
        mean = z.mean(axis=0)
        norm = np.linalg.norm(mean)
        variance = (np.abs(z - mean) ** 2).sum() / (_PILOT_RUNS - 1)
        return float(np.sqrt(variance) / norm) if norm > 0 else 0.0


@dataclass(frozen=True)
class ManyLightExposure:
    """One measurement, with its lights.

    Attributes
    ----------
    lights : virtual lights; empty without a hidden object.
    error : estimated error of the hidden phasors, relative to them; None without a hidden object.
    """

    scene: mi.Scene
    view: View
    lights: Lights
    error: float | None

    @property
    def attributes(self) -> dict[str, str]:
        """Provenance for the file: number of lights, and estimated error of the hidden signal."""
        counts = {"lights": str(len(self.lights))}
        return counts if self.error is None else {**counts, "hidden_error": f"{self.error:.3g}"}

    def phasors(self) -> PhasorImage:
        """Phasors without time bins; the hidden part has no noise from the direct return."""
        grid, frequencies_hz = Grid(self.view.layout.width, self.view.layout.height), self.view.frequencies_hz
        direct = gather_direct(self.scene, grid, frequencies_hz, _DIRECT_RULE, self.view.seed)
        hidden = gather_lights(self.scene, grid, frequencies_hz, self._hidden_rule, self.lights)
        return PhasorImage(direct + hidden, direct, hidden, self.error)

    def row_blocks(self) -> Iterator[NDArray[np.float32]]:
        """Image rows from top to bottom, in blocks (rows, W, T) of radiance per bin, W m^-2 sr^-1."""
        layout = self.view.layout
        packets = self.lights.packets(_PACKETS)
        rule = midpoint_rule(min(max(_DIRECT_CELLS // layout.width, _FEWEST_CELLS), _MOST_CELLS))
        step = min(layout.rows_per_block, max(1, 2**22 // (layout.width * rule.count)))
        for start in range(0, layout.height, step):
            rows = (start, min(start + step, layout.height))
            yield splat_rows(
                self.scene, layout, rows, self.lights, packets, rule, self._hidden_rule, self.view.seed
            )

    @property
    def _hidden_rule(self) -> PixelRule:
        return gauss_rule(2 if 1 / self.view.layout.width > _WIDE_PIXEL else 1)
