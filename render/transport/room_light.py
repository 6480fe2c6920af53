"""The light of a room that reflects: all light of three bounces that met its surfaces.

The surfaces are the middle wall, floor, ceiling and back wall; light that met the hidden object, too, is part
of it. Every path ends with one of these legs to the camera:

- straight from a surface of the room that an emitter lights: a direct return,
- from a virtual light on such a surface to the relay wall or another one (`render.transport.many_light`),
- from the hidden object, lit over a surface of the room, to the relay wall: virtual lights, too,
- from the relay wall or the object to a surface of the room (`render.transport.passes.room_pixels`).

docs/science/renderer.md, Rooms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.options import ManyLightOptions
from render.transport.film.pixels import Grid
from render.transport.lights.arrivals import Incoming
from render.transport.lights.hidden_surface import hidden_shapes, read_surface, surface_reflectance
from render.transport.lights.light_pass import NoLightError
from render.transport.many_light import FIRST_TRIAL, RUNS, LightWorkshop, ManyLightExposure, hidden_rule
from render.transport.method import View
from render.transport.passes.direct_pass import gather_direct
from render.transport.passes.room_pixels import RoomNodes

if TYPE_CHECKING:
    import mitsuba as mi

BOUNCES = 3
_RELAY_WALL = "relay_wall"
_LEAST_ERROR, _MOST_ERROR = 6e-3, 1.0  # of the light of one set of lights
_MOST_POINTS = 2**12  # of a run: more help little where a surface in view touches the relay wall
_MOST_PAIRS = 2**26  # of lights and nodes of a lattice
_OF_PIXELS = 0.1  # error of the mean over pixels that cannot be interpolated, for which nodes are added
_STREAM = 2**31  # of random numbers, beside those of images and trials


@dataclass(frozen=True)
class RoomLight:
    """The light of a room.

    Attributes
    ----------
    phasors : (H, W, F) radiance, W m^-2 sr^-1.
    error : upper bound of its error, relative to the hidden light; relative to itself where there is none.
    """

    phasors: NDArray[np.complex128]
    error: float


def room_light(
    options: ManyLightOptions,
    scene: mi.Scene,
    without_wall: mi.Scene,
    view: View,
    hidden: NDArray[np.complexfloating],
) -> RoomLight:
    """The light of the room of a scene, of at most three bounces.

    Parameters
    ----------
    scene, without_wall : the scene, and the same without the relay wall.
    hidden : (H, W, F) hidden light of the scene in a black room.

    Raises
    ------
    SceneError, HiddenSurfaceError : this method cannot render the scene.
    """
    grid, shapes = Grid(view.layout.width, view.layout.height), {each.id(): each for each in scene.shapes()}
    wall, objects = shapes[_RELAY_WALL], hidden_shapes(scene)
    room = [
        shape
        for name, shape in shapes.items()
        if name != _RELAY_WALL and shape not in objects and surface_reflectance(shape) > 0
    ]
    strength = np.linalg.norm(hidden.astype(complex), axis=(0, 1))  # (F,)
    phasors, missed = np.zeros(hidden.shape, complex), np.zeros_like(strength)
    image = ManyLightExposure(scene, view, None, options.edge_divisions, options.error, None).direct_image
    for lit, incoming in ((room, Incoming(direct=True)), (objects, Incoming(over=room))):
        surface = read_surface(lit)
        if surface is None:
            continue
        try:
            workshop = replace(LightWorkshop.of(scene, surface, view, incoming), most_points=_MOST_POINTS)
        except NoLightError:
            continue
        exposure = workshop.exposure(_options(options, workshop, strength, grid), _MOST_PAIRS)
        exposure = replace(exposure, wanted=_OF_PIXELS)
        vars(exposure)["direct_image"] = image  # the same
        found = exposure.phasors()
        phasors += found.hidden
        missed = np.hypot(missed, (found.error or 0.0) * np.linalg.norm(found.hidden, axis=(0, 1)))
    nodes = RoomNodes.of(scene, room, grid, hidden_rule(grid.width), image)
    if len(nodes.pixel):
        direct = gather_direct(without_wall, grid, view.frequencies_hz, view.seed, options.edge_divisions)
        phasors += direct.phasors
        beside = strength if strength.all() else np.linalg.norm(direct.phasors, axis=(0, 1))
        light_of = (scene, view.frequencies_hz, wall, objects)
        pixels, light, left = nodes.light(*light_of, view.seed, options.error * beside)
        phasors.reshape(-1, len(strength))[pixels] += light
        missed = np.hypot(np.hypot(missed, left), direct.missed)
    whole = strength if strength.all() else np.linalg.norm(phasors, axis=(0, 1))
    error = float(np.divide(missed, whole, out=np.zeros_like(missed), where=whole > 0).max())
    return RoomLight(phasors, error)


def _options(
    options: ManyLightOptions, workshop: LightWorkshop, strength: NDArray[np.float64], grid: Grid
) -> ManyLightOptions:
    """Options by which the lights have the wanted error, relative to hidden light of norm `strength` (F,)."""
    if options.lights or not strength.all():
        return options
    tried = workshop.evaluated(FIRST_TRIAL, RUNS, _STREAM)[1].values.mean(axis=0)  # (P, F)
    mean = np.linalg.norm(tried, axis=0) / np.sqrt(len(tried))
    times = float((strength / np.sqrt(grid.width * grid.height) / mean).min()) if mean.all() else 1.0
    return replace(options, error=float(np.clip(options.error * times, _LEAST_ERROR, _MOST_ERROR)))
