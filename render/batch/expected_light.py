"""The hidden light to expect in a corner, from scenes that are drawn and rendered at a small size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from disk.counted import counted
from disk.frequency_text import megahertz
from render.backend import Device
from render.batch.light import BatchedLight, LightImages, suits
from scenegen import Preset
from scenegen.depth_range import NO_MESHES
from scenegen.geometry_check import refusal
from scenegen.possible_scenes import possible_scenes
from scenegen.scene import Scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_SCENES: Final = 12
# Pixels. Images twice as large change the shares by less than 0.001 of them.
_LONGEST_SIDE, _SHORTEST_SIDE = 40, 8
_ERROR: Final = 0.04  # of the hidden light
NO_LIGHT: Final = (
    "hidden light: not computed, because the projector is not at the camera, or the wall is too smooth"
)


@dataclass(frozen=True)
class ExpectedLight:
    """Hidden light of scenes over all light of the relay wall, with at most three bounces.

    Attributes
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    shares : for each scene, the norm of the image of hidden light over that of direct light, at the highest
        frequency.
    turns_rad : (F,) by how much the hidden light turns the phases: root mean square over the image, weighted
        with the light, median of the scenes; radians.
    no_object_m : MAE of depth maps without an object, metres.
    """

    frequencies_hz: tuple[float, ...]
    shares: tuple[float, ...]
    turns_rad: tuple[float, ...]
    no_object_m: float

    @classmethod
    def of_images(cls, images: LightImages, frequencies_hz: tuple[float, ...]) -> ExpectedLight:
        """That of the light of scenes; scenes whose camera sees no light of the wall do not count."""
        power = np.abs(images.direct) ** 2  # (N, H, W, F)
        some = (power.sum(axis=(1, 2)) > 0).all(axis=-1)
        power, direct, hidden = power[some], images.direct[some], images.hidden[some]
        total = power.sum(axis=(1, 2))  # (N, F)
        shares = np.sqrt((np.abs(hidden) ** 2).sum(axis=(1, 2)) / total)
        turns = np.angle(1 + hidden / np.where(power > 0, direct, 1))
        mean = (power * turns**2).sum(axis=(1, 2)) / total
        highest = int(np.argmax(frequencies_hz))
        turns_rad = np.sqrt(np.median(mean, axis=0)).tolist()
        no_object_m = float(images.radial_depth_m.mean())
        return cls(frequencies_hz, tuple(shares[:, highest].tolist()), tuple(turns_rad), no_object_m)

    def as_data(self) -> dict[str, Any]:
        """The numbers as plain data."""
        return asdict(self)

    @property
    def sentence(self) -> str:
        """The numbers as text."""
        least, middle, most = (f"{100 * np.quantile(self.shares, part):.2g}" for part in (0, 0.5, 1))
        turns = ", ".join(f"{1000 * turn:.2g}" for turn in self.turns_rad)
        return (
            f"hidden light: {middle} % of the direct light, {least} to {most} in "
            f"{counted(len(self.shares), 'drawn scene')}; it turns the phases by {turns} mrad at "
            f"{megahertz(*self.frequencies_hz)}"
        )


def expected_light(
    preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES, *, device: Device = "auto"
) -> ExpectedLight | None:
    """Draw the first scenes of a preset and compute their light; None if the engine cannot.

    It cannot where the projector is not at the camera, or the wall is too smooth.

    Parameters
    ----------
    meshes : the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    SamplingError : no scene fits the corner.
    BackendError : this machine cannot render on the requested device.
    """
    hidden = preset.hidden_object
    if hidden.empty_fraction < 1:
        preset = replace(preset, hidden_object=replace(hidden, empty_fraction=0.0))
    camera, hz = preset.camera, preset.itof.frequencies_hz
    sides = (camera.width, camera.height)
    smaller = max(_LONGEST_SIDE / max(sides), min(1.0, _SHORTEST_SIDE / min(sides)))
    size = [round(smaller * side) for side in sides]
    draw = possible_scenes(preset, partial(refusal, meshes=meshes))
    step = -(-preset.dataset.count // _SCENES) if preset.is_sequence else 1
    scenes = [_resized(draw(index), *size) for index in range(0, preset.dataset.count, step)[:_SCENES]]
    if not all(map(suits, scenes)):
        return None
    engine = BatchedLight(hz, *size, error=_ERROR, meshes=meshes, device=device)
    return ExpectedLight.of_images(engine.images(scenes), hz)


def _resized(scene: Scene, width: int, height: int) -> Scene:
    return replace(scene, camera=replace(scene.camera, width=width, height=height))
