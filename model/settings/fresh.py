"""The endless stream of scenes of a preset that a training sees, each once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from pydantic.dataclasses import dataclass

from disk.contract import STRICT
from disk.quantities import Positive
from scenegen import Preset, Scene
from scenegen.geometry_check import refusal
from scenegen.sampling import sample_valid_scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh


@dataclass(frozen=True, config=STRICT)
class FreshScenes:
    """Which scenes a training sees. Scene i depends on nothing but this, the training's seed and i.

    Attributes
    ----------
    preset : of the scenes; its number of scenes and its splits do not matter.
    error : error of their hidden light, relative to it.
    """

    preset: Preset
    error: Positive

    def with_seed(self, seed: int) -> FreshScenes:
        """The stream of a training with this seed. No dataset of the preset has the same scenes."""
        words = np.random.SeedSequence([seed, self.preset.dataset.seed, 1]).generate_state(1, np.uint64)
        dataset = replace(self.preset.dataset, seed=int(words[0] >> np.uint64(1)))
        return replace(self, preset=replace(self.preset, dataset=dataset))

    @property
    def fields_of_view_deg(self) -> tuple[float, ...]:
        """Smallest and largest horizontal field of view, degrees; empty if all scenes have the same."""
        middle_deg, by_deg = (
            self.preset.camera.horizontal_fov_deg,
            self.preset.camera_spread.horizontal_fov_deg,
        )
        return (middle_deg - by_deg, middle_deg + by_deg) if by_deg else ()

    def scene(self, index: int, meshes: Mapping[Shape, UnitMesh]) -> Scene:
        """Scene `index` of the stream.

        Raises
        ------
        SamplingError : the preset's ranges leave no room.
        """
        return sample_valid_scene(self.preset, index, partial(refusal, meshes=meshes))
