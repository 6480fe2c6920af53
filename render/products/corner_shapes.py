"""What pictures of a corner show: walls, light, field of view, hidden region and distances, in world axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from render.products.corner_facts import CornerFacts, region_box
from scenegen import Preset
from scenegen.corner_geometry import Frustum, Points, corners_of, distances_m, lit_points
from scenegen.pose import wall_normal
from scenegen.sampling import projector_of, room_of, walls_of

RELAY, MIDDLE, LIT, CAMERA, HIDDEN = "#4477aa", "#222222", "#ddaa00", "#228833", "#cc3311"
ROOM = "#888888"
_SHOWN: Final = 1500  # lit points
_WALL: Final = ((0, 1, 2, 3),)
_PYRAMID: Final = ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1))
_BOX: Final = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


@dataclass(frozen=True)
class Solid:
    """A wall, a box or the field of view: corners (N, 3), its faces by their indices, and how it is drawn."""

    name: str
    colour: str
    points: Points
    faces: tuple[tuple[int, ...], ...]
    filled: bool = True
    dotted: bool = False
    width: float = 1.5


@dataclass(frozen=True)
class CornerShapes:
    """What pictures of a corner show, metres.

    Attributes
    ----------
    solids : walls, what reflects of the room, hidden region, and field of view as far as the relay wall.
    lit : (N, 3) some points of the relay wall that are seen and lit.
    eye : (3,) the camera.
    distances : ends (2, 3) and texts of the distances from the relay wall: of the camera, of the middle wall
        and of the hidden region.
    """

    solids: tuple[Solid, ...]
    lit: Points
    eye: Points
    distances: tuple[tuple[Points, str], ...]

    @classmethod
    def of(cls, preset: Preset, facts: CornerFacts) -> CornerShapes:
        """Those of the corner of a preset."""
        relay, middle = walls_of(preset)
        room = {wall.name.replace("_", " "): corners_of(wall) for wall in room_of(preset)}
        view, eye = Frustum.of_camera(preset.camera), np.array(preset.camera.location_m)
        rays = view.corner_rays()
        reach = view.hits(relay, rays)
        reach = np.where(np.isfinite(reach), reach, 2 * max(facts.camera_m, 0.5))
        lit = lit_points(preset.camera, projector_of(preset, preset.camera), relay, middle)
        seen = np.vstack([eye, eye + rays * reach[:, None]])
        corners, box, far_box = corners_of(middle), region_box(preset), region_box(preset, facts.radius_m)
        edge = corners[distances_m(relay, corners).argmin()]
        distances = []
        for place, what in ((eye, ""), (edge, "gap "), (box.mean(axis=0), "")):
            off_m = float(distances_m(relay, place[None])[0])
            distances.append((np.stack([place, place - off_m * wall_normal(relay)]), f"{what}{off_m:.2f} m"))
        return cls(
            solids=(
                Solid("relay wall", RELAY, corners_of(relay), _WALL, filled=False, width=3),
                Solid("middle wall", MIDDLE, corners, _WALL, filled=False, width=3),
                *(Solid(name, ROOM, points, _WALL, filled=False) for name, points in room.items()),
                Solid("reach of hidden objects", HIDDEN, far_box, _BOX, filled=False, dotted=True),
                Solid("centres of hidden objects", HIDDEN, box, _BOX),
                Solid("field of view", CAMERA, seen, _PYRAMID, width=0.8),
            ),
            lit=np.random.default_rng(0).permutation(lit)[:_SHOWN],
            eye=eye,
            distances=tuple(distances),
        )
