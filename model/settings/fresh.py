"""The endless stream of scenes of a preset that a training sees, each once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import STRICT
from scenegen import Preset, Scene
from scenegen.geometry_check import refusal
from scenegen.possible_scenes import sample_valid_scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh


@dataclass(frozen=True, config=STRICT)
class FreshScenes:
    """Which scenes a training sees. Scene i depends on nothing but this, the training's seed and i.

    Attributes
    ----------
    preset : of the scenes; its number of scenes and its splits do not matter.
    meshes : digests (`UnitMesh.digest`) of the user's meshes, by shape.
    """

    preset: Preset
    meshes: Annotated[dict[Shape, str], Field(exclude_if=lambda value: not value)] = field(
        default_factory=dict
    )

    @classmethod
    def of(cls, preset: Preset, meshes: Mapping[Shape, UnitMesh]) -> FreshScenes:
        """The stream of a preset with these meshes."""
        return cls(preset, {shape: mesh.digest for shape, mesh in meshes.items()})

    def with_seed(self, seed: int) -> FreshScenes:
        """The stream of a training with this seed. No dataset of the preset has the same scenes."""
        words = np.random.SeedSequence([seed, self.preset.dataset.seed, 1]).generate_state(1, np.uint64)
        dataset = replace(self.preset.dataset, seed=int(words[0] >> np.uint64(1)))
        return replace(self, preset=replace(self.preset, dataset=dataset))

    @property
    def fields_of_view_deg(self) -> tuple[float, ...]:
        """Smallest and largest horizontal field of view, degrees; empty if all scenes have the same."""
        camera, spread = self.preset.camera, self.preset.camera_spread
        middle_deg, by_deg = camera.horizontal_fov_deg, spread.horizontal_fov_deg
        return (middle_deg - by_deg, middle_deg + by_deg) if by_deg else ()

    def scene(self, index: int, meshes: Mapping[Shape, UnitMesh]) -> Scene:
        """Scene `index` of the stream.

        Raises
        ------
        SamplingError : the preset's ranges leave no room.
        """
        return sample_valid_scene(self.preset, index, partial(refusal, meshes=meshes))
