"""Method ``many-light``: virtual lights on the hidden surface light every pixel over the relay wall.

docs/science/renderer.md derives the estimator and lists its errors.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.options import COARSEST_EDGES, ManyLightOptions
from render.transport.film.lattice import Lattice
from render.transport.film.pixels import Grid, PixelRule, gauss_rule
from render.transport.kernels.rough_wall import register_rough_wall
from render.transport.lights.arrivals import OVER_THE_WALL, Incoming
from render.transport.lights.hidden_surface import HiddenSurface, read_hidden_surface
from render.transport.lights.light_pass import Lights, light_density, make_lights
from render.transport.lights.run_statistics import needed_points
from render.transport.method import LitRows, PhasorImage, View
from render.transport.passes.direct_pass import FINEST_ERROR, DirectImage, gather_direct
from render.transport.passes.direct_samples import sample_direct
from render.transport.passes.gather_pass import gather_runs
from render.transport.passes.hidden_pass import (
    HiddenField,
    HiddenImage,
    RunValues,
    first_lattice,
    make_field,
)
from render.transport.scene_checks import USE_PATH, SceneError, check_many_light_scene

if TYPE_CHECKING:
    import mitsuba as mi

_FEWEST_WALL_POINTS, _MOST_WALL_POINTS = 32, 256  # for each surface point
_LIGHT_PATHS = 2**16  # surface points times wall points
RUNS = 8  # at least, in a trial and in an image
_FEWEST_POINTS, FIRST_TRIAL, _MOST_POINTS = 32, 128, 2**14  # on the hidden surface, of a run
_REFINED = 1.5  # lights that lack this factor of points get new runs with twice the points, others more runs
_MARGIN = 0.85  # of the wanted error: what the lights are planned for; the rest is for chance
_FOR_LIGHTS = 0.96  # of the wanted error; a quarter of it for the interpolation makes it whole
_FOR_NODES = 0.1  # of the wanted error, for the nodes of a pixel
_FEWEST_LIT = 8  # nodes with hidden light, which know its error
_FINEST_COLUMNS = 160  # of the last lattice that is tried for them
_WIDE_PIXEL = 4e-3  # of the image width; the hidden part of wider pixels takes 2 x 2 nodes instead of one

log = logging.getLogger(__name__)


class ManyLight:
    """The method ``many-light``: phasors without time bins, and transients from the same lights.

    Parameters
    ----------
    options : `lights` fixes the number of surface points. Without it, trials find the number that the
        hidden-signal error `error` needs.
    variant : the active Mitsuba variant.
    """

    name = ManyLightOptions.method

    def __init__(self, options: ManyLightOptions, variant: str) -> None:
        self.options = options
        self._variant = variant

    @property
    def rough_wall(self) -> str:
        """Our plugin, which Mitsuba loads sooner than its own."""
        return register_rough_wall(self._variant)

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
            return ManyLightExposure(scene, view, None, self.options.edge_divisions, self.options.error, None)
        return LightWorkshop.of(scene, surface, view).exposure(self.options)


@dataclass(frozen=True)
class LightWorkshop:
    """Makes sets of lights for one measurement, for trials and for the image.

    `surface` is that of the lights, `incoming` the light that they get, and `most_points` the most points of
    a run.
    """

    scene: mi.Scene
    surface: HiddenSurface
    density: NDArray[np.float64]
    view: View
    incoming: Incoming = OVER_THE_WALL
    most_points: int = _MOST_POINTS

    @classmethod
    def of(
        cls, scene: mi.Scene, surface: HiddenSurface, view: View, incoming: Incoming = OVER_THE_WALL
    ) -> LightWorkshop:
        """With the density of the light.

        Raises
        ------
        HiddenSurfaceError : no light reaches the surface, or light that is not finite.
        """
        return cls(scene, surface, light_density(scene, surface, view.seed, incoming), view, incoming)

    def exposure(self, options: ManyLightOptions, most_pairs: int | None = None) -> ManyLightExposure:
        """The measurement of the scene.

        Parameters
        ----------
        most_pairs : of a light and a node of a lattice over the film; its error counts. None: no limit, and
            an image without a lattice where none is fine enough.

        Raises
        ------
        SceneError : the light of the surface cannot be estimated.
        """
        layout, wanted = self.view.layout, None if options.lights else options.error
        try:
            lights, found = self.chosen(options)
        except ValueError as error:
            raise SceneError(f"the hidden signal cannot be estimated ({error}): {USE_PATH}") from None
        most_nodes = layout.width * layout.height * hidden_rule(layout.width).count
        if most_pairs is not None:
            most_nodes = min(most_nodes, most_pairs // max(1, len(lights)))
        field = make_field(
            self.scene,
            lights,
            self.view.frequencies_hz,
            found,
            most_nodes=max(most_nodes, len(found.lattice.nodes) + 1),
            wanted=wanted,
            settles=most_pairs is not None,
        )
        log.debug("%d lights of %d runs, %s", len(lights), lights.runs, field.lattice)
        wanted = field.error if wanted is None else wanted
        strength = _strength(self.scene, found)
        return ManyLightExposure(self.scene, self.view, field, options.edge_divisions, wanted, strength)

    def chosen(self, options: ManyLightOptions) -> tuple[Lights, RunValues]:
        """The lights of the image, and the hidden signal by each of their runs."""
        if options.lights is not None:
            runs = min(RUNS, max(2, options.lights))
            return self.evaluated(-(-options.lights // runs), runs, 0)
        count = FIRST_TRIAL
        needed = float(count)
        for trial in itertools.count(1):
            error = self.evaluated(count, RUNS, trial)[1].error
            needed = needed_points(count, error, _MARGIN * options.error)
            if needed <= 4 * count or count >= self.most_points:
                break
            count *= 4
        needed = min(max(needed, _FEWEST_POINTS), self.most_points)
        # Powers of two make the most even points; the number of runs makes up for the rest.
        count = 2 ** int(np.log2(needed))
        runs = int(np.ceil(RUNS * needed / count))
        lights, found = self.evaluated(count, runs, 0)
        wanted = _FOR_LIGHTS * options.error
        # The trial was lucky. More of the same hardly lower the estimate of the error, which all runs give.
        stream = 0
        while found.error > wanted and lights.runs * count < RUNS * self.most_points:
            if needed_points(count, found.error, wanted) > _REFINED * count:
                stream, count = stream - 1, 2 * count
                lights, found = self.evaluated(count, RUNS, stream)
            else:
                runs = int(np.ceil(lights.runs * ((found.error / wanted) ** 2 - 1) * 1.1))
                lights, found = self.with_more_runs(lights, found, count, runs, stream)
        if found.error > options.error:
            log.warning("the hidden-signal error is %.2g even with %d lights", found.error, len(lights))
        return lights, found

    def lights(self, count: int, runs: int, stream: int, first_run: int = 0) -> Lights:
        """Lights of independent runs with `count` surface points each; stream 0 is the image."""
        wall_points = min(max(_LIGHT_PATHS // (count * RUNS), _FEWEST_WALL_POINTS), _MOST_WALL_POINTS)
        numbers = np.random.SeedSequence([self.view.seed, 1, stream % 2**32]).generate_state(first_run + runs)
        seeds = [int(number) for number in numbers[first_run:]]
        own = (self.scene, self.surface, self.density)
        return make_lights(*own, count, wall_points, seeds, self.view.max_bounces, self.incoming)

    def evaluated(
        self, count: int, runs: int, stream: int, first_run: int = 0, lattice: Lattice | None = None
    ) -> tuple[Lights, RunValues]:
        """Lights, and the hidden signal by each run at the nodes of a lattice.

        Without a given one, it is the coarsest with several nodes that hidden light reaches: these know its
        error. Behind a narrow gap, the coarsest of all has none.
        """
        lights = self.lights(count, runs, stream, first_run)
        tried = lattice or first_lattice(self.view.layout.width / self.view.layout.height)
        while True:
            values = gather_runs(self.scene, tried.nodes, self.view.frequencies_hz, lights)
            lit = np.count_nonzero(values.any(axis=(0, 2)))
            if lattice or not len(lights) or lit >= _FEWEST_LIT:
                return lights, RunValues(tried, values)
            if tried.columns >= _FINEST_COLUMNS:
                raise ValueError(f"it reaches {lit} of {len(tried.nodes)} points of the image")
            tried = tried.halved()

    def with_more_runs(
        self, lights: Lights, found: RunValues, count: int, runs: int, stream: int
    ) -> tuple[Lights, RunValues]:
        """The lights of the image with further runs."""
        more, values = self.evaluated(count, runs, stream, lights.runs, found.lattice)
        return lights.joined(more), replace(found, values=np.concatenate([found.values, values.values]))


@dataclass(frozen=True)
class ManyLightExposure:
    """One measurement, with its lights.

    Attributes
    ----------
    field : the hidden signal over the film; None without a hidden object.
    edge_divisions : how often a pixel is divided where an edge that is none of the walls' crosses it.
    wanted : error, relative to the hidden signal.
    strength : of the hidden signal, relative to the direct return; None without a hidden object.
    """

    scene: mi.Scene
    view: View
    field: HiddenField | None
    edge_divisions: int
    wanted: float
    strength: float | None

    @property
    def error(self) -> float | None:
        """Bound of the error of the hidden phasors, relative to them; None without a hidden object."""
        if self.field is None or self._hidden is None:
            return None
        norm = np.linalg.norm(self._hidden.phasors, axis=(0, 1))
        missed = np.hypot(self._hidden.missed, self.direct_image.missed)
        of_pixels = np.divide(missed, norm, out=np.zeros_like(norm), where=norm > 0).max()
        return float(np.linalg.norm([self.field.error, self._rule[1], of_pixels]))

    @property
    def attributes(self) -> dict[str, str]:
        """Provenance for the file: number of lights, and bound of the error of the hidden signal."""
        if self.field is None:
            return {"lights": "0"}
        return {"lights": str(len(self.field.lights)), "hidden_error": f"{self.error:.3g}"}

    def phasors(self) -> PhasorImage:
        """Phasors without time bins; the hidden part has no noise from the direct return."""
        direct = self.direct_image.phasors
        hidden = np.zeros_like(direct) if self._hidden is None else self._hidden.phasors
        return PhasorImage(direct + hidden, direct, hidden, self.error)

    def row_blocks(self) -> Iterator[NDArray[np.float32]]:
        """Image rows from top to bottom, in blocks (rows, W, T) of radiance per bin, W m^-2 sr^-1."""
        return self.lit_rows().of_all_bins(self.view.layout.bin_count)

    def lit_rows(self) -> LitRows:
        """The same rows, of the bins that light may reach."""
        from render.transport.passes.transient_pass import transient_rows

        return transient_rows(self.scene, self.view, self._grid, self._rule[0], self.direct_image, self.field)

    @cached_property
    def _hidden(self) -> HiddenImage | None:
        if self.field is None:
            return None
        return self.field.image(self._grid, self._rule[0], self.direct_image, _FOR_NODES * self.wanted)

    @cached_property
    def _rule(self) -> tuple[PixelRule, float]:
        """Nodes for the hidden part of a pixel that sees one surface, and the error that they leave."""
        rule = hidden_rule(self._grid.width)
        if self.field is None:
            return rule, 0.0
        return self.field.enough_nodes(self._grid, rule, self.direct_image, _FOR_NODES * self.wanted)

    @cached_property
    def direct_image(self) -> DirectImage:
        """The direct return, and which surface each pixel shows."""
        view = self.view
        allowed = FINEST_ERROR if self.strength is None else _FOR_NODES * self.wanted * self.strength
        return gather_direct(
            *(self.scene, self._grid, view.frequencies_hz, view.seed),
            edge_divisions=COARSEST_EDGES if view.all_is_direct else self.edge_divisions,
            allowed=None if view.all_is_direct else allowed,
        )

    @property
    def _grid(self) -> Grid:
        return Grid(self.view.layout.width, self.view.layout.height)


def _strength(scene: mi.Scene, found: RunValues) -> float:
    """Norm of the hidden signal over that of the direct return, at the nodes of the trials."""
    direct = np.linalg.norm(sample_direct(scene, found.lattice.nodes, 0).radiance.astype(float))
    hidden = np.linalg.norm(found.values.mean(axis=0), axis=0).min()
    return float(hidden / direct) if direct > 0 else 1.0  # then all of it has nodes of its own


def hidden_rule(width: int) -> PixelRule:
    """Nodes for the hidden part of a pixel in an image of this width."""
    return gauss_rule(2 if 1 / width > _WIDE_PIXEL else 1)
