"""The hidden light of solids, by three bounces: relay wall, solid, relay wall.

With the projector at the camera, a point w of the wall in direction r gets the flux Φ of its part of the film
and sends irradiance E to a point s of a solid; s is Lambertian with reflectance 1 and lights every wall point
x that a pixel sees:

    E_f(s) = sum_w Φ_w f(r_w, s - w) cos_w cos_s / |s - w|² exp(j k_f (t_w + |s - w|))
    hidden_f(x) = sum_s A_s / π E_f(s) f(s - x, r_x) cos_x cos_s / |s - x|² exp(j k_f (|s - x| + t_x))

over the direct light f(r_x, r_x) cos_x Φ / t_x², with visibility as 0 or 1. The sums are quadratures over the
film and over the surfaces: a few hundred points each suffice for 1 % of the hidden light.

Source: the estimator of docs/science/renderer.md, with fixed points in place of random ones; flat walls only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from itof import phase_per_metre
from model.refinement.light.room import Room
from model.refinement.light.rough_wall import reflected
from model.refinement.light.solids import Solid

_FILM_NODES = {True: (12, 9), False: (6, 5)}  # of the light from the wall, across and down
_LIFT = 1e-4  # of the way: a ray of a surface starts beside it


class Bounces:
    """Computes the hidden light of solids in a room, for some pixels.

    Parameters
    ----------
    room : with the relay wall where the measurement shows it.
    rays : (P, 3) unit rays of the pixels, which all meet the relay wall.
    aspect : width over height of the image.
    frequencies_hz : F modulation frequencies, Hz.
    fine : more points on film and surfaces, for 1 % of the hidden light; else about 3 %.
    """

    def __init__(
        self,
        room: Room,
        rays: NDArray[np.float64],
        aspect: float,
        frequencies_hz: Sequence[float],
        *,
        fine: bool,
    ) -> None:
        half = math.tan(math.radians(room.horizontal_fov_deg) / 2)
        (x, across), (y, down) = (np.polynomial.legendre.leggauss(count) for count in _FILM_NODES[fine])
        film = np.stack([*np.meshgrid(x * half, y * half / aspect), np.ones((len(y), len(x)))], axis=-1)
        film = film.reshape(-1, 3) / np.linalg.norm(film.reshape(-1, 3), axis=1, keepdims=True)
        meets = film @ room.plane_per_m > 0
        flux = np.outer(down, across).ravel()[meets] * half**2 / aspect  # of a projector of 1 W/m² at 1 m
        self.room, self._fine, self._frequencies_hz = room, fine, tuple(frequencies_hz)
        self._rays, self._aspect = rays, aspect
        self._lit, self._seen = _WallPoints.of(room, film[meets]), _WallPoints.of(room, rays)
        self._flux = torch.as_tensor(flux, dtype=torch.float32)
        self._per_metre = [float(k) for k in phase_per_metre(frequencies_hz)]

    def with_plane(self, plane_per_m: NDArray[np.float64]) -> Bounces:
        """The same pixels in front of a wall elsewhere."""
        room = self.room.with_plane(plane_per_m)
        return Bounces(room, self._rays, self._aspect, self._frequencies_hz, fine=self._fine)

    def over_direct(self, solids: Sequence[Solid], roughness: float | None) -> NDArray[np.complex128]:
        """(P, F) hidden light of the union of solids, relative to the direct light of each pixel.

        Parameters
        ----------
        roughness : of the relay wall; None for a Lambertian one.
        """
        parts = [self._of_part(solids, place, roughness) for place in range(len(solids))]
        return (torch.stack(parts).sum(0) / self._direct(roughness)[:, None]).numpy().astype(np.complex128)

    def of_points(
        self, position_m: NDArray[np.float64], cross_section_m2: float, roughness: float | None
    ) -> NDArray[np.complex128]:
        """(S, P, F) hidden light of each of S points that scatter evenly, relative to the direct light.

        The sums of the module for one point s each, without cosines there:

            hidden_f(x) = σ / 4π E_f(s) f(s - x, r_x) cos_x / |s - x|² exp(j k_f (|s - x| + t_x))

        Parameters
        ----------
        position_m : (S, 3) their places, metres.
        cross_section_m2 : σ, the power that a point scatters over the irradiance that it gets.
        roughness : of the relay wall; None for a Lambertian one.
        """
        position = torch.as_tensor(position_m, dtype=torch.float32)
        arriving = self._way(self._lit, position, (), roughness)
        leaving = self._way(self._seen, position, (), roughness)
        strength = cross_section_m2 / (4 * math.pi) * leaving.strength / self._direct(roughness)
        columns = []
        for per_metre in self._per_metre:
            there = torch.polar(
                self._flux * arriving.strength, per_metre * (arriving.distance_m + self._lit.distance_m)
            ).sum(1, keepdim=True)
            back = torch.polar(strength, per_metre * (leaving.distance_m - self._seen.distance_m))
            columns.append(there * back)
        return torch.stack(columns, dim=-1).numpy().astype(np.complex128)

    def _direct(self, roughness: float | None) -> Tensor:
        """(P,) direct light, W m^-2 sr^-1, of a projector of 1 W/m² at 1 m."""
        seen = self._seen
        lobe = reflected(-seen.rays, -seen.rays, seen.normal, roughness, self.room.reflectance)
        return lobe / (seen.rays[:, 2] ** 3 * seen.distance_m**2)

    def _of_part(self, solids: Sequence[Solid], place: int, roughness: float | None) -> Tensor:
        """(P, F) light of the surface of one solid that is outside the others."""
        solid, others = solids[place], [*solids[:place], *solids[place + 1 :]]
        points, normals, areas = solid.surface(self._fine)
        free = ~np.any([other.contains(points) for other in others], axis=0) if others else slice(None)
        position, normal, area = (
            torch.as_tensor(each[free], dtype=torch.float32) for each in (points, normals, areas)
        )
        hiding = [*others, solid] if solid.is_sheet else others
        arriving = self._way(self._lit, position, hiding, roughness)
        leaving = self._way(self._seen, position, hiding, roughness)
        sides = (normal, -normal) if solid.is_sheet else (normal,)
        return torch.stack([self._exchanged(arriving, leaving, side, area) for side in sides]).sum(0)

    def _way(
        self, wall: _WallPoints, position: Tensor, hiding: Sequence[Solid], roughness: float | None
    ) -> _Way:
        """From wall points to (S, 3) points of a surface."""
        gap = position[:, None] - wall.position_m  # (S, W, 3)
        distance_m = gap.norm(dim=-1)
        direction = gap / distance_m[..., None]
        # The material is the same both ways: what the wall sends to s from r, it sends to r from s.
        camera = -wall.rays.expand_as(direction)
        strength = reflected(camera, direction, wall.normal, roughness, self.room.reflectance)
        strength = strength / distance_m**2
        start = position[:, None].expand_as(gap) - _LIFT * gap
        for solid in hiding:
            strength = torch.where(solid.first_hit(start, -gap) < 1 - 2 * _LIFT, 0, strength)
        for rectangle in self.room.occluders:
            hidden = rectangle.hides(wall.position_m.expand_as(gap), position[:, None].expand_as(gap))
            strength = torch.where(hidden, 0, strength)
        return _Way(direction, distance_m, strength)

    def _exchanged(self, arriving: _Way, leaving: _Way, normal: Tensor, area: Tensor) -> Tensor:
        """(P, F) hidden light by one side of a surface, without the optical path of pixels to the wall."""
        lit, seen = self._lit, self._seen
        power = self._flux * arriving.onto(normal)
        back = leaving.onto(normal)
        columns = []
        for per_metre in self._per_metre:
            phase = per_metre * (arriving.distance_m + lit.distance_m)
            sent = torch.complex((power * torch.cos(phase)).sum(1), (power * torch.sin(phase)).sum(1))
            sent = sent * (area / math.pi)  # (S,)
            phase = per_metre * (leaving.distance_m - seen.distance_m)  # the direct light has 2 t, this t
            columns.append(sent @ torch.complex(back * torch.cos(phase), back * torch.sin(phase)))
        return torch.stack(columns, dim=-1)


@dataclass(frozen=True)
class _WallPoints:
    """Points of the relay wall: (W, 3) rays and positions, (W,) distances, (3,) normal."""

    rays: Tensor
    position_m: Tensor
    distance_m: Tensor
    normal: Tensor

    @classmethod
    def of(cls, room: Room, rays: NDArray[np.float64]) -> _WallPoints:
        distance_m = 1 / (rays @ room.plane_per_m)
        arrays = (rays, rays * distance_m[:, None], distance_m, room.wall_normal)
        return cls(*(torch.as_tensor(each, dtype=torch.float32) for each in arrays))


@dataclass(frozen=True)
class _Way:
    """Between S points of a surface and W of the wall: (S, W, 3) direction to the surface, (S, W) others."""

    direction: Tensor
    distance_m: Tensor
    strength: Tensor

    def onto(self, normal: Tensor) -> Tensor:
        """(S, W) strength times the cosine at the surface, 0 behind it."""
        return self.strength * (-(self.direction @ normal[:, :, None])[..., 0]).clamp(min=0)
