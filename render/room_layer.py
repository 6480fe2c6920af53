"""The room's light of a scene, which measurements hold as a layer of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from render.settings import RenderError
from render.transport.lights.hidden_surface import HiddenSurfaceError
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.room_light import BOUNCES, RoomLight, room_light
from render.transport.scene_checks import SceneError
from render.transport.scene_loading import scene_from_data
from scenegen import Scene
from scenegen.mitsuba_description import room_description, seen_description


def refuse_room(scene: Scene, bounces: int, wants_transients: bool) -> None:
    """`RenderError` for a room that reflects, where its light is wanted over time or of other bounces."""
    if scene.room_reflects and (wants_transients or bounces != BOUNCES):
        what = "time-resolved light" if wants_transients else f"light of {bounces} bounces"
        raise RenderError(
            f"scene {scene.id}: its room reflects ([room] of the preset), and only --method path renders "
            f"{what} of such rooms: use it, or --product itof with {BOUNCES} bounces"
        )


def room_layer(
    scene: Scene,
    files: Mapping[str, bytes],
    folder: Path,
    method: ManyLight,
    view: View,
    hidden: NDArray[np.complexfloating],
) -> RoomLight:
    """The light of a room that reflects.

    Parameters
    ----------
    files, folder : contents of the scene's files by name, and where they are.
    hidden : (H, W, F) hidden light of the scene in a black room.

    Raises
    ------
    RenderError : the method cannot render the scene.
    """
    try:
        lit, without_wall = (
            scene_from_data(described, files, folder, method.rough_wall)
            for described in (seen_description(scene), room_description(scene))
        )
        return room_light(method.options, lit, without_wall, view, hidden)
    except (SceneError, HiddenSurfaceError) as error:
        raise RenderError(f"scene {scene.id}: its room: {error}") from None
