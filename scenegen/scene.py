"""A scene as plain data: what is in it, where it is, and where it came from."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from scenegen.contract import (
    STRICT,
    Extent,
    FieldOfView,
    Positive,
    Reflectance,
    Roughness,
    Vector,
    checked,
)
from scenegen.preset import CameraSettings, Material
from scenegen.shapes import Shape

COMPOSITE = "composite"
Split = Literal["train", "validation", "test"]


@dataclass(frozen=True, config=STRICT)
class HiddenObject:
    """One primitive or mesh: what it is, where its centre is, XYZ Euler angles in degrees.

    `size_m` are a primitive's extents along its own axes. Of a mesh (shape ``mesh:FILE``) it is the cube
    that the longest side of the mesh's own bounding box fills; the mesh keeps its proportions.
    """

    shape: Shape
    size_m: Extent
    location_m: Vector
    rotation_deg: Vector
    reflectance: Reflectance


@dataclass(frozen=True, config=STRICT)
class Wall:
    """A rectangle that faces +z before it is turned; size along its own x and y."""

    size_m: tuple[Positive, Positive]
    location_m: Vector
    rotation_deg: Vector


@dataclass(frozen=True, config=STRICT)
class RelayWall(Wall):
    """The wall that camera and hidden object both see; `roughness` is None for a diffuse wall."""

    material: Material
    reflectance: Reflectance
    roughness: Roughness | None


Camera = CameraSettings  # a scene's camera is the one that its preset sets


@dataclass(frozen=True, config=STRICT)
class Emitter:
    """Projector with uniform flux over its image plane: radiant intensity π irradiance / cos³ (off-axis)."""

    horizontal_fov_deg: FieldOfView
    location_m: Vector
    rotation_deg: Vector
    irradiance: Positive


@dataclass(frozen=True, config=STRICT)
class Scene:
    """Everything of one scene.

    Attributes
    ----------
    index : place in the dataset; with `dataset_seed` it fixes all that follows.
    attempt : how many samples were rejected by the geometry check before this one.
    seed : seed of the scene's rendering.
    object_class : a shape, or ``composite``.
    split : train, validation or test.
    """

    index: Annotated[int, Field(ge=0)]
    dataset_seed: Annotated[int, Field(ge=0)]
    attempt: Annotated[int, Field(ge=0)]
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    object_class: str
    split: Split
    hidden_objects: Annotated[tuple[HiddenObject, ...], Field(min_length=1)]
    relay_wall: RelayWall
    middle_wall: Wall
    camera: Camera
    emitter: Emitter
    max_bounces: Annotated[int, Field(ge=1)]
    schema_version: Literal[1] = 1

    @property
    def id(self) -> str:
        """Name of the scene's folders: the zero-padded index."""
        return scene_id(self.index)


def scene_id(index: int) -> str:
    """Zero-padded index; six digits, so that a dataset can grow without renaming."""
    return f"{index:06d}"


def scene_to_json(scene: Scene) -> str:
    """``scene.json`` text."""
    return TypeAdapter(Scene).dump_json(scene, indent=2).decode() + "\n"


def scene_from_json(text: str, origin: str) -> Scene:
    """Scene from the text of a ``scene.json``; `ContractError` names what is wrong and `origin`."""
    scene: Scene = checked(TypeAdapter(Scene), text, origin)
    return scene
