"""A scene as plain data: its objects, their places, its split, and the seed that it was drawn from."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from disk.contract import STRICT, checked
from disk.quantities import (
    BeamAngle,
    ClassName,
    Extent,
    Positive,
    Reflectance,
    Roughness,
    Vector,
    WholeTurn,
)
from scenegen.preset import MOST_BOUNCES, CameraSettings, Material
from scenegen.projector import Dots, Spacing, check_dots
from scenegen.shapes import Shape

COMPOSITE = "composite"
EMPTY = "no_object"
Split = Literal["train", "validation", "test"]
RoomWallName = Literal["floor", "ceiling", "back_wall"]


@dataclass(frozen=True, config=STRICT)
class HiddenObject:
    """One primitive or mesh: shape, extents, centre in metres, and XYZ Euler angles in degrees.

    `size_m` is a primitive's extents along its own axes. For a mesh (shape ``mesh:FILE``) all three values
    are the length of the longest side of its bounding box; the mesh keeps its proportions.
    """

    shape: Shape
    size_m: Extent
    location_m: Vector
    rotation_deg: Vector
    reflectance: Reflectance


@dataclass(frozen=True, config=STRICT)
class Wall:
    """A rectangle that faces +z before its rotation. `size_m` is along its own x and y."""

    size_m: tuple[Positive, Positive]
    location_m: Vector
    rotation_deg: Vector


@dataclass(frozen=True, config=STRICT)
class MiddleWall(Wall):
    """The diffuse wall that hides the object from the camera."""

    reflectance: Annotated[Reflectance, Field(exclude_if=lambda value: value == 0)] = 0.0


@dataclass(frozen=True, config=STRICT)
class RoomWall(Wall):
    """A diffuse surface around the corner; it faces the room."""

    name: RoomWallName
    reflectance: Reflectance


@dataclass(frozen=True, config=STRICT)
class Darkening:
    """Reflectance that falls linearly over a wall.

    Attributes
    ----------
    least_reflectance : at the darkest corner.
    direction_deg : of the fall, from the wall's own +x towards its own +y.
    """

    least_reflectance: Reflectance
    direction_deg: WholeTurn


@dataclass(frozen=True, config=STRICT)
class RelayWall(Wall):
    """The wall that camera and hidden object both see.

    Attributes
    ----------
    reflectance : at the brightest corner if there is a `darkening`, else everywhere.
    roughness : None for a diffuse wall.
    """

    material: Material
    reflectance: Reflectance
    roughness: Roughness | None
    darkening: Annotated[Darkening | None, Field(exclude_if=lambda value: value is None)] = None


Camera = CameraSettings  # that of the preset, moved by its camera_spread


@dataclass(frozen=True, config=STRICT)
class Emitter:
    """A projector whose flux is uniform over its image plane, or over the dots there (`ProjectorSettings`).

    Its radiant intensity at the angle o to the optical axis is π irradiance / cos³ o.
    """

    horizontal_fov_deg: BeamAngle
    location_m: Vector
    rotation_deg: Vector
    irradiance: Positive
    dots: Annotated[Dots | None, Field(exclude_if=lambda value: value is None)] = None
    spacing: Annotated[Spacing, Field(exclude_if=lambda value: value == 1)] = 1

    def __post_init__(self) -> None:
        check_dots(self.dots, self.spacing)


@dataclass(frozen=True, config=STRICT)
class Scene:
    """Everything of one scene.

    Attributes
    ----------
    index : position in the dataset; index and `dataset_seed` determine everything else.
    attempt : number of samples that the geometry check rejected before this one.
    seed : seed of the scene's rendering.
    object_class : a shape, ``composite``, or ``no_object`` in an empty corner.
    split : train, validation or test.
    max_bounces : number of surfaces that light may meet.
    mirror_occluders : whether the mirrored scene has the mirror image of the middle wall.
    room : floor, ceiling and back wall, as far as they reflect.
    """

    index: Annotated[int, Field(ge=0)]
    dataset_seed: Annotated[int, Field(ge=0)]
    attempt: Annotated[int, Field(ge=0)]
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    object_class: ClassName
    split: Split
    hidden_objects: tuple[HiddenObject, ...]
    relay_wall: RelayWall
    middle_wall: MiddleWall
    camera: Camera
    emitter: Emitter
    max_bounces: Annotated[int, Field(ge=1, le=MOST_BOUNCES)]
    mirror_occluders: Annotated[bool, Field(exclude_if=lambda value: value is False)] = False
    room: Annotated[tuple[RoomWall, ...], Field(exclude_if=lambda value: not value)] = ()
    schema_version: Literal[1] = 1

    @property
    def id(self) -> str:
        """Name of the scene's folders: see `scene_id`."""
        return scene_id(self.index)

    @property
    def room_reflects(self) -> bool:
        """Whether any surface but the relay wall and the objects reflects light."""
        return bool(self.room) or self.middle_wall.reflectance > 0

    def in_black_room(self) -> Scene:
        """The scene whose middle wall is black, without the surfaces of its room."""
        return replace(self, middle_wall=replace(self.middle_wall, reflectance=0.0), room=())

    @property
    def has_flash(self) -> bool:
        """Whether the projector is at the camera and lights its whole field of view evenly."""
        camera, emitter = self.camera, self.emitter
        place = (camera.location_m, camera.rotation_deg, camera.horizontal_fov_deg)
        of_emitter = (emitter.location_m, emitter.rotation_deg, emitter.horizontal_fov_deg)
        return place == of_emitter and emitter.dots is None


def scene_id(index: int) -> str:
    """Index with six digits, so that a dataset can grow without renaming."""
    return f"{index:06d}"


def scene_to_json(scene: Scene) -> str:
    """Text of a ``scene.json``."""
    return TypeAdapter(Scene).dump_json(scene, indent=2).decode() + "\n"


def scene_from_json(text: str | bytes, origin: str) -> Scene:
    """Scene from the text of a ``scene.json``; `origin` names the file in the message of an error.

    Raises
    ------
    ContractError : not JSON, an unknown or missing key, or an impossible value; the message names the key.
    """
    scene: Scene = checked(TypeAdapter(Scene), text, origin)
    return scene
