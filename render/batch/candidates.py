"""The light of scenes that may be the measured one, at a few pixels: for searches among many of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from render.backend import Device
from render.batch.hidden import first_level, ratios
from render.batch.light import mirrored_depth_m
from render.batch.quadrature import Nodes, on_wall
from render.batch.tables import World
from scenegen.scene import Scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_FILM_LEVELS: Final = {True: 3, False: 1}  # by `fine`
_FINER: Final = 2  # levels of the surface points, with `fine`
_AT_ONCE: Final = 2**18  # pixels, for the memory


class CandidateLight:
    """Computes hidden light with fixed nodes, and mirror images.

    Parameters
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    meshes, device, threads : as those of `render.batch.tables.World`.

    Raises
    ------
    BackendError : this machine cannot render on the requested device.
    """

    def __init__(
        self,
        frequencies_hz: Sequence[float],
        meshes: Mapping[Shape, UnitMesh] | None = None,
        device: Device = "auto",
        threads: int | None = None,
    ) -> None:
        self._frequencies_hz = tuple(frequencies_hz)
        self._world = World(meshes, device, threads, mixes_roughness=True)

    def over_direct(
        self, scenes: Sequence[Scene], rays: NDArray[np.float64], *, fine: bool
    ) -> NDArray[np.complex128]:
        """(N, P, F) hidden light of N scenes over their direct light.

        Parameters
        ----------
        rays : (P, 3) directions in camera axes, which meet the plane of the relay wall; even where it is
            hidden, the light is that of the wall.
        fine : more nodes, for an error of about 1 %; else about 3 %.
        """
        parts = [self._over_direct(part, rays, fine) for part in _divided(scenes, len(rays))]
        return (
            np.concatenate(parts) if parts else np.zeros((0, len(rays), len(self._frequencies_hz)), complex)
        )

    def mirrored_depth_m(self, scenes: Sequence[Scene], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, P) radial depth of the mirror images of the objects along (P, 3) directions; 0 beside them."""
        parts = [
            mirrored_depth_m(
                self._world.scenes(part, self._frequencies_hz),
                np.broadcast_to(rays, (len(part), *rays.shape)),
            )
            for part in _divided(scenes, len(rays))
        ]
        return np.concatenate(parts).astype(np.float64)

    def _over_direct(
        self, scenes: Sequence[Scene], rays: NDArray[np.float64], fine: bool
    ) -> NDArray[np.complex128]:
        count = len(scenes)
        ready, every = self._world.scenes(scenes, self._frequencies_hz), np.arange(count)
        film = np.broadcast_to(rays[:, :2] / rays[:, 2:], (count, len(rays), 2))
        seen = Nodes.of(count, np.repeat(every, len(rays)), on_wall(ready.corners, film).reshape(-1, 3))
        surface = np.array([first_level(scene) + _FINER * fine for scene in scenes])
        levels = surface, np.full(count, _FILM_LEVELS[fine])
        return ratios(ready, every, *levels, seen, self._world.meshes).reshape(count, len(rays), -1)


def _divided(scenes: Sequence[Scene], pixels: int) -> list[Sequence[Scene]]:
    """The scenes in parts that fit into memory."""
    at_once = max(1, _AT_ONCE // pixels)
    return [scenes[start : start + at_once] for start in range(0, len(scenes), at_once)]
