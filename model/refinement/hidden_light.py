"""What a measurement shows of the hidden light, once its own wall and phase offsets are taken out of it.

The unknowns of the self-calibration (`itof.wall.self_calibration`) take a few dimensions of the hidden light
with them. The same dimensions are taken out of the light of a model, so that both can be compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from itof.other_surfaces import only_wall
from itof.wall.expected_wall import ExpectedWall
from itof.wall.self_calibration import calibrate
from itof.weighted_reference import weighted_reference
from model.refinement.blocks import Blocks
from model.refinement.pixel_noise import pixel_noise

_ROWS: Final = {True: 15, False: 10}  # of blocks of pixels, about: the hidden light is smooth over the wall
_FEWEST_BLOCKS = 24  # for the unknowns of wall and phases, and for those of a solid
_LEAST_PER_M = 1e-3  # a wall that is farther is none
_WALL_STEPS = 2  # of Gauss and Newton
_MODEL = 0.006  # error of a model's light, of the usual hidden light


@dataclass(frozen=True)
class HiddenLight:
    """The light of blocks of pixels over the direct light of a wall, and what of it can be compared.

    Attributes
    ----------
    relative : (P, F) phasors over the direct light, with the modulus 1 at the first frequency.
    rays : (P, 3) unit rays of the blocks.
    plane_per_m : (3,) plane of the relay wall whose direct light it is.
    weight : (P,) of the blocks: the inverse standard deviation of errors, in any unit. Those of the model are
        taken to fall with the wall's brightness; noise adds to them.
    slope : (F,) phase of the direct light by the wall's distance, rad/m.
    amplitude : (P,) of the light at the first frequency, in any unit.
    noise : root mean square of the noise in a component of `relative` times `weight`, estimated.
    where : (R, C) which of the `blocks` of the image these are.
    parts : (P, n, 3) unit rays of the parts of each.
    """

    relative: NDArray[np.complex128]
    rays: NDArray[np.float64]
    plane_per_m: NDArray[np.float64]
    weight: NDArray[np.float64]
    slope: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    noise: float
    where: NDArray[np.bool_]
    blocks: Blocks
    parts: NDArray[np.float64]

    @classmethod
    def of(
        cls, phasor: NDArray[np.complexfloating[Any, Any]], wall: ExpectedWall, *, fine: bool
    ) -> HiddenLight | None:
        """The light of a measurement (H, W, F) over the direct light of the wall that it shows by itself.

        Parameters
        ----------
        wall : where the relay wall is expected.
        fine : smaller blocks of pixels.

        Returns
        -------
        None where too few blocks of pixels see the wall, or there is no hidden light at all.
        """
        found = calibrate(phasor, wall)
        direct = weighted_reference(found.moved(phasor, wall), np.abs(phasor[..., 0]))
        strength = np.abs(direct[..., :1])
        safe = np.where((phasor != 0).all(-1) & (direct != 0).all(-1), 1.0, np.nan)[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = phasor * np.conj(direct) / np.abs(direct) ** 2 * strength
            relative = relative / np.abs(phasor[..., :1]) * safe
        # In a pixel that shows an edge, the direct return alone is off by more than the hidden light.
        safe = np.where((only_wall(np.nan_to_num(relative)) != 0).all(-1), 1.0, np.nan)[..., None]
        relative = relative * safe
        strength = np.abs(wall.direct[..., :1]) * safe
        strength = strength / np.nanmax(strength, initial=np.finfo(float).tiny)
        blocks = Blocks.of(len(phasor), _ROWS[fine])
        amplitude = np.abs(phasor[..., :1]) * safe
        noise = pixel_noise(relative.imag, amplitude[..., 0])[..., None] * blocks.gain_of_noise
        shown = (relative, wall.rays * safe, strength, noise, amplitude)
        relative, rays, weight, noise, amplitude = (blocks.middles(each) for each in shown)
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        plane = np.asarray(found.plane_per_m)
        good = np.isfinite(relative).all(-1) & (rays @ plane > _LEAST_PER_M)
        if np.count_nonzero(good) < _FEWEST_BLOCKS:
            return None
        relative, rays, weight, noise = relative[good], rays[good], weight[good, 0], noise[good, 0]
        weight = weight / np.sqrt(1 + (noise * weight / _error_of_model(relative.imag, weight)) ** 2)
        noisy = float(np.sqrt(((noise * weight) ** 2).mean()))
        parts = blocks.rays_of_parts(wall.rays, good)
        numbers = (plane, weight, np.asarray(wall.slope), amplitude[good, 0], noisy)
        light = cls(relative, rays, *numbers, good, blocks, parts)
        return light if light.values.any() else None

    def with_wall_behind(self, hidden: NDArray[np.complex128]) -> HiddenLight:
        """The same light over that of the wall which remains when `hidden` light (P, F) is taken out.

        The calibration takes hidden light for a wall that is elsewhere by up to a centimetre. If a model says
        how much hidden light there is, the wall is where the rest of the phases says.
        """
        light = self
        for _ in range(_WALL_STEPS):
            phases = np.angle(light.relative / (1 + hidden)) * self.weight[:, None]  # (P, F)
            columns = light._of_wall()
            change = np.linalg.lstsq(columns, phases.T.ravel(), rcond=None)[0]
            plane = light.plane_per_m + change[:3]
            if not (self.rays @ plane > _LEAST_PER_M).all():
                return self  # a model that leaves no wall
            moved_m = 1 / (self.rays @ plane) - 1 / (self.rays @ light.plane_per_m)
            turn = moved_m[:, None] * self.slope + change[3:]
            light = replace(light, relative=light.relative * np.exp(-1j * turn), plane_per_m=plane)
        return light

    @cached_property
    def values(self) -> NDArray[np.float64]:
        """(M,) comparable values of the measurement."""
        return self._comparable(self.relative)

    @property
    def noise_power(self) -> float:
        """Expected sum of the squares of the noise in `values`, with three standard deviations above.

        Phases have the noise of one component. Differences of real parts have twice the power, because both
        are divided by the same amplitude.
        """
        blocks, frequencies = self.relative.shape
        freedoms = blocks * (3 * frequencies - 2)
        return self.noise**2 * freedoms * (1 + 3 * math.sqrt(2 / freedoms))

    def of_model(self, hidden: NDArray[np.complex128]) -> NDArray[np.float64]:
        """(M,) comparable values of a model's hidden over direct light (P, F)."""
        relative = 1 + hidden
        return self._comparable(relative / np.abs(relative[:, :1]))

    def _comparable(self, relative: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Weighted phases without the lost dimensions, and differences of real parts between frequencies."""
        phases = (relative.imag * self.weight[:, None]).T.ravel()  # (F P,)
        phases = phases - self._lost @ (self._lost.T @ phases)
        real = (relative.real[:, 1:] - relative.real[:, :1]) * self.weight[:, None]
        return np.concatenate([phases, real.T.ravel()])

    @cached_property
    def _lost(self) -> NDArray[np.float64]:
        """(F P, 3 + F) orthonormal basis of what the calibration takes out of the phases."""
        basis: NDArray[np.float64] = np.linalg.qr(self._of_wall())[0]
        return basis

    def _of_wall(self) -> NDArray[np.float64]:
        """(F P, 3 + F) derivatives of the weighted phases by the plane and by an offset of each frequency."""
        moved = -((1 / (self.rays @ self.plane_per_m)) ** 2)[:, None] * self.rays * self.weight[:, None]
        of_plane = np.concatenate([slope * moved for slope in self.slope])
        of_offsets = np.kron(np.eye(len(self.slope)), self.weight[:, None])
        return np.concatenate([of_plane, of_offsets], axis=1)


def _error_of_model(phases: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    """Usual error of a model in weighted phases (P, F)."""
    usual = float(np.median(np.abs(phases * weight[:, None])))
    return max(_MODEL * usual, float(np.finfo(float).tiny))
