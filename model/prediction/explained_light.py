"""Whether a predicted depth map explains the light that was measured.

The hidden light of the predicted surface (`model.prediction.surface_light`) goes the way of the measured one:
it is added to the wall's return as the image shows it, and becomes channels, so that it loses the same
dimensions to the self-calibration. What it leaves, beyond noise, is not explained. Its strength is free,
because the brightness of the object and of the wall's lobe are not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from itof import DepthMap, residual_channels
from itof.arrays import Bools, Floats, Phasors
from itof.wall.expected_wall import ExpectedWall
from itof.wall.finding import Finding
from model.network.channels import InputSpec
from model.prediction.one_scene import other_scene
from model.prediction.surface_light import surface_light

_WEAK: Final = 2e-3  # of the direct return: as much hidden light as there may be
_SIGMAS: Final = 5.0  # of the energy of noise: less light tells nothing
# Chosen by benchmarks/foreign_measurements.py: good answers explain more than half where noise is low.
SHARE_REFUSED: Final = 0.02
SHARE_NOTED: Final = 0.2
LEAST_LIGHT: Final = 1e-4  # of the direct return; scenes of the presets have 3e-4 to 4e-3
MOST_LIGHT: Final = 0.03
_CAUSES: Final = (
    "a room that reflects, a camera that is not calibrated (a capture of the empty corner removes both), "
    "another corner"
)


@dataclass(frozen=True)
class ExplainedLight:
    """Hidden light of an image, relative to its direct return, and what a prediction explains of it.

    Attributes
    ----------
    strength : root mean square of what is not the wall's, without noise; 0 if noise hides it.
    noise : of a pixel.
    hideable : strength of the light that this noise would hide.
    share : part of its energy that the predicted surface explains, at most 1; 0 without an object; None if
        noise hides it.
    other_scene : which part of the image holds light of another scene, in words
        (`model.prediction.one_scene`);
        empty if none does, or if it was not looked for.
    """

    strength: float
    noise: float
    hideable: float
    share: float | None
    other_scene: str = ""

    @property
    def words(self) -> str:
        """The outcome as text."""
        if self.share is None:
            return f"noise hides the hidden light if it is below {_per_mille(self.hideable)}"
        return (
            f"{100 * self.share:.0f} % of the hidden light is explained, which is {_per_mille(self.strength)}"
        )

    def findings(self, *, shows_object: bool) -> Iterator[Finding]:
        """What makes an answer with or without an object doubtful; one that explains nothing is refused."""
        strength, share, refused = _per_mille(self.strength), self.share, False
        if share is None:
            words = (
                f"noise hides the hidden light ({_per_mille(self.hideable)} would be seen), so the object "
            )
            words += "is a guess of the network: average more frames"
            is_doubtful = shows_object
        elif self.strength > MOST_LIGHT:
            words = f"what is not the wall's light is {strength}, far more than hidden light is: a camera "
            words += "that is not calibrated, a bright room, or parts of several measurements?"
            is_doubtful, refused = True, shows_object and share < SHARE_REFUSED
        elif self.other_scene and share >= SHARE_REFUSED:
            words = f"{self.other_scene}: parts of several measurements?"
            is_doubtful = True
        elif shows_object:
            words = (
                f"the object that the network shows explains {100 * share:.0f} % of the light that is not "
            )
            words += f"the wall's: {_CAUSES}, or parts of several measurements?"
            is_doubtful, refused = share < SHARE_NOTED, share < SHARE_REFUSED
        else:
            words = f"the network shows no object, but {strength} is not the wall's light: {_CAUSES}, or an "
            words += "object that the network does not know?"
            is_doubtful = self.strength > LEAST_LIGHT
        if is_doubtful:
            yield Finding("unexplained", words, refused)


def _per_mille(strength: float) -> str:
    return f"{1e3 * strength:.2g} per mille of the direct light"


def explained_light(
    inputs: InputSpec,
    phasor: ArrayLike,
    wall: ExpectedWall,
    prediction: DepthMap,
    *,
    thorough: bool = False,
) -> ExplainedLight:
    """Compare the hidden light of an image (H, W, F) with that of its prediction.

    Parameters
    ----------
    inputs : of a network with residual channels.
    wall : as `Predictor.predict` takes it, with the computed or captured return.
    thorough : also look for parts of other scenes, which takes a tenth of a second.
    """
    z = np.asarray(phasor, dtype=np.complex128)
    measured, direct = _light(inputs, z, wall)
    used = (measured != 0).all(axis=0)
    noise, alike = _noise_energy(measured, used)  # of a value
    count = max(int(used.sum()) * len(measured), 1)
    energy = float((measured[:, used] ** 2).sum()) - count * noise
    hideable = _SIGMAS * noise * np.sqrt(2 / alike)  # mean square
    known = float(np.sqrt(noise)), float(np.sqrt(hideable))
    if energy <= count * hideable:
        return ExplainedLight(0.0, *known, None)
    share = 0.0
    there = wall
    if inputs.self_calibrates:
        there = replace(wall, plane_per_m=np.asarray(inputs.fit_of(z[None], wall).plane_per_m)[0])
    hidden = surface_light(np.asarray(prediction.radial_depth_m, np.float64), prediction.mask, there)
    largest = float(np.abs(hidden).max())
    if largest > 0:
        weak = _WEAK * float(np.abs(direct).max()) / largest * hidden
        model = _light(inputs, direct + weak, wall)[0] - _light(inputs, direct, wall)[0]
        model = model * used
        along = float((measured * model).sum())
        share = max(along, 0.0) ** 2 / float((model**2).sum()) / energy
    other = other_scene(measured, direct, there, prediction) if thorough else ""
    return ExplainedLight(float(np.sqrt(energy / count)), *known, min(share, 1.0), other)


def hidden_light(inputs: InputSpec, phasor: ArrayLike, wall: ExpectedWall) -> Floats:
    """(H, W) light of an image (H, W, F) that is not the wall's, relative to the mean direct return.

    It is the root mean square of the residual channels; the other parameters as in `explained_light`.
    """
    residual, _ = _light(inputs, np.asarray(phasor, dtype=np.complex128), wall)
    rms: Floats = np.sqrt((residual**2).mean(axis=0))
    return rms


def _light(inputs: InputSpec, z: Phasors, wall: ExpectedWall) -> tuple[Floats, Phasors]:
    """Residual channels (C, H, W) relative to the mean direct return, and the direct return (H, W, F)."""
    reference = np.asarray(inputs.parted(inputs.reference_of_image(z[None], wall))[0])
    direct = np.broadcast_to(reference, (1, *z.shape))
    strength = np.abs(z[..., 0])
    as_bright = direct[0] * (strength / np.maximum(np.abs(direct[0, ..., 0]), 1e-300))[..., None]
    residual = residual_channels(z[None], direct, "uniform", wall_alone=inputs.wall_alone)[0]
    return np.asarray(residual, np.float64) * strength / max(float(strength.mean()), 1e-300), as_bright


def _noise_energy(light: Floats, used: Bools) -> tuple[float, float]:
    """Mean square of the noise of (C, H, W), by second differences in a row; and of how many values.

    Values of equal noise have a mean fourth power of three times the squared mean square; bright pixels count
    for more than others, so they are as good as fewer values.
    """
    row = used[:, 2:] & used[:, 1:-1] & used[:, :-2]
    bend = (light[..., 2:] - 2 * light[..., 1:-1] + light[..., :-2])[:, row]
    square = float((bend**2).mean()) if bend.size else 0.0
    fourth = float((bend**4).mean()) if bend.size else 0.0
    return square / 6, max(3 * bend.size * square**2 / fourth, 1.0) if fourth > 0 else 1.0
