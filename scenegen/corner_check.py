"""Whether a corner can be: what all scenes of a preset share is checked before anything is made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from scipy.optimize import linprog

from disk.preset_files import PresetError
from scenegen.corner_geometry import Frustum, Points, corners_of, crosses, distances_m, lit_points, local
from scenegen.depth_range import NO_MESHES, largest_radius_m, refuse_wrapping_depths
from scenegen.geometry_check import CLEARANCE_M, possible_region, refusal
from scenegen.pose import camera_axes, wall_normal
from scenegen.possible_scenes import refuse_impossible_objects
from scenegen.preset import CameraSettings, CameraSpread, Preset
from scenegen.sampling import projector_of, room_of, sample_scene, walls_of
from scenegen.scene import Emitter, Wall
from scenegen.shapes import MESH_PREFIX, PRIMITIVES, Shape
from scenegen.unit_meshes import UnitMesh

_CAMERAS: Final = 6  # of those that are spread
_PLACES: Final = 7  # along each side of the region; of 3, none may be both hidden and in the light
_MOVE: Final = "move middle_wall.location_m or give it a smaller middle_wall.size_m"


def refuse_impossible_corner(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> None:
    """Refuse a preset whose scenes cannot be, or cannot be rendered, wherever their objects are.

    Where each scene has its camera elsewhere, one of several cameras must do; the sentence is about the one
    in the middle.

    Parameters
    ----------
    meshes : the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    PresetError : one sentence. The camera is behind or beside the relay wall or turned away; the walls cross
        or leave no gap; no light gets to the hidden region; its objects are behind the relay wall or in view;
        or the frequencies do not represent every depth (`refuse_wrapping_depths`).
    SamplingError : an object, or a frame of a sequence, fits nowhere (`refuse_impossible_objects`).
    """
    for problem in _behind(preset, walls_of(preset)[0]):
        raise PresetError(problem)
    for problem in _problems(preset, meshes):
        if all(any(_problems(corner, meshes)) for corner in _other_corners(preset)):
            raise PresetError(problem)
        break
    refuse_wrapping_depths(preset, meshes)
    if {*preset.shapes} <= {*PRIMITIVES, *meshes}:
        refuse_impossible_objects(preset, partial(refusal, meshes=meshes))


def _other_corners(preset: Preset) -> Iterator[Preset]:
    """The corners of some scenes, if each has its camera elsewhere."""
    for index in range(0 if preset.is_one_corner else _CAMERAS):
        yield replace(preset, camera=sample_scene(preset, index).camera, camera_spread=CameraSpread())


def _problems(preset: Preset, meshes: Mapping[Shape, UnitMesh]) -> Iterator[str]:
    """Why the corner cannot be; a check may rely on those before it, and on `_behind`."""
    relay, middle = walls_of(preset)
    camera, projector = preset.camera, projector_of(preset, preset.camera)
    for who, place in (("camera", camera.location_m), ("projector", projector.location_m)):
        for wall in room_of(preset):
            if distances_m(wall, np.array([place]))[0] <= CLEARANCE_M:
                yield (
                    f"the {who} at {list(place)} is behind the {wall.name} of the room, which spans from the "
                    "relay wall to the end of the middle wall: move it or enlarge the walls"
                )
    seen = Frustum.of_camera(camera).points_on(relay)
    if not len(seen):
        yield _looks_elsewhere(camera, relay)
    gap_m = float(distances_m(relay, corners_of(middle)).min())
    if gap_m < -CLEARANCE_M and _meet(relay, middle):
        yield f"the middle wall crosses the relay wall and reaches {-gap_m:.3g} m behind it: {_MOVE}"
    if crosses(middle, np.array(camera.location_m), seen).all():
        yield f"the middle wall hides all of the relay wall from the camera: {_MOVE}"
    points = lit_points(camera, projector, relay, middle)
    if not len(points):
        yield "the projector lights nothing of the relay wall that the camera sees: turn or move it"
    if not preset.is_sequence:  # whose frames are checked one by one
        yield from _in_view(preset, relay, middle, projector, meshes)
    places = _region(preset, largest_radius_m(preset, meshes), relay, middle)
    if len(places) and all(crosses(middle, place, points).all() for place in places):
        if gap_m <= CLEARANCE_M and _meet(relay, middle):
            yield f"the middle wall touches the relay wall, so that there is no gap for the light: {_MOVE}"
        yield (
            "no lit point of the relay wall sees the region of hidden_object.location_m: the middle wall, "
            f"whose edge is {gap_m:.3g} m from the relay wall, hides it: {_MOVE}, or move the region"
        )


def _behind(preset: Preset, relay: Wall) -> Iterator[str]:
    moved_m = preset.camera_spread.location_m * np.abs(wall_normal(relay)).sum()
    gap_m = float(distances_m(relay, np.array([preset.camera.location_m]))[0] - moved_m)
    if gap_m <= 0:
        spread = "" if preset.is_one_corner else ", moved by camera_spread.location_m,"
        yield (
            f"camera.location_m{spread} is {round(-gap_m, 6):zg} m behind the front of the relay wall, which "
            "the camera must see: move the camera or turn the wall with relay_wall.rotation_deg"
        )


def _looks_elsewhere(camera: CameraSettings, relay: Wall) -> str:
    """Why no ray of the image meets the relay wall."""
    forward, normal = camera_axes(camera)[2], wall_normal(relay)
    angle_deg = float(np.degrees(np.arccos(np.clip(-forward @ normal, -1, 1))))
    what = f"its axis is {angle_deg:.3g} degrees from the direction straight towards the wall"
    if angle_deg < 90:
        gap_m = float(distances_m(relay, np.array([camera.location_m]))[0])
        x, y, _ = local(relay, camera.location_m + forward * gap_m / np.cos(np.radians(angle_deg)))
        what = (
            f"its axis meets the plane of the wall {abs(x):.3g} m and {abs(y):.3g} m from the middle of the "
            f"wall, which ends at {relay.size_m[0] / 2:g} m and {relay.size_m[1] / 2:g} m"
        )
    return f"the camera sees nothing of the relay wall, because {what}: turn the camera, or move one"


def _in_view(
    preset: Preset, relay: Wall, middle: Wall, projector: Emitter, meshes: Mapping[Shape, UnitMesh]
) -> Iterator[str]:
    """Why no object's centre is possible, which is in the convex hull of primitives, not of all meshes."""
    has_mesh = any(shape.startswith(MESH_PREFIX) for shape in preset.shapes)
    margin_m = largest_radius_m(preset, meshes) if has_mesh else 0.0
    ranges, wider_m = preset.places_m, np.array([-margin_m, margin_m])
    box = np.array([ranges.x, ranges.y, ranges.z]) + wider_m  # (3, 2)
    for eye, who in ((preset.camera.location_m, "camera"), (projector.location_m, "projector")):
        if abs(distances_m(middle, np.array([eye]))[0]) <= CLEARANCE_M:
            yield (
                f"the {who} at {list(eye)} is in the plane of the middle wall, which hides nothing from "
                "there: move one of them"
            )
        region = possible_region(relay, middle, eye)  # (6, 4)
        behind_m = -float(_most(region[:1], box)[0])
        if behind_m >= 0:
            yield (
                f"hidden_object.location_m is at least {behind_m:.2g} m behind the front of the relay wall: "
                "move it to where the wall faces"
            )
        if (_most(region, box) <= 0).any() or not _has_point(region, box):
            yield (
                f"the {who} at {list(eye)} sees every place of hidden_object.location_m beside the middle "
                "wall, which must hide the object: move the region behind the middle wall, or enlarge or "
                "move that wall"
            )


def _most(region: Points, box: Points) -> Points:
    """Largest value of n · x + d in a box (3, 2), of each half-space (n, d)."""
    most: Points = np.maximum(region[:, :3] * box[:, 0], region[:, :3] * box[:, 1]).sum(axis=1)
    return most + region[:, 3]


def _has_point(region: Points, box: Points) -> bool:
    """Whether a point of the box (3, 2) is in all half-spaces n · x + d >= 0."""
    return bool(linprog(np.zeros(3), -region[:, :3], region[:, 3], bounds=box).status == 0)


def _region(preset: Preset, radius_m: float, relay: Wall, middle: Wall) -> Points:
    """(N, 3) possible places in the box that objects of this radius may reach."""
    ranges = preset.places_m
    wider = ((low - radius_m, high + radius_m) for low, high in (ranges.x, ranges.y, ranges.z))
    sides = [np.linspace(low, high, _PLACES) for low, high in wider]
    places = np.array(list(product(*sides)))
    region = possible_region(relay, middle, preset.camera.location_m)
    possible: Points = places[(places @ region[:, :3].T + region[:, 3] > 0).all(axis=1)]
    return possible


def _meet(relay: Wall, middle: Wall) -> bool:
    """Whether the walls cross, or come closer than the least distance of an object."""
    for wall, other in ((relay, middle), (middle, relay)):
        starts = corners_of(other)
        ends = np.roll(starts, -1, axis=0)
        along = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True) * CLEARANCE_M
        if crosses(wall, starts - along, ends + along, CLEARANCE_M).any():
            return True
    return False
