"""The light of scenes that may be the measured one, at a few pixels: for searches among many of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from render.backend import Device
from render.batch.hidden import direct, first_level, ratios
from render.batch.light import depths_of_solids_m, mirrored_depth_m
from render.batch.quadrature import Nodes, on_wall
from render.batch.tables import Scenes, World, rows_of
from render.walls.corners import Corners
from scenegen.scene import Scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_FILM_LEVELS: Final = {True: 3, False: 1}  # by `fine`
_FINER: Final = 3  # levels of the surface points with `fine`
_Parted = TypeVar("_Parted", Sequence[Scene], NDArray[np.float64])
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
        fine : more nodes, for an error of about 1 %; else about 3 %, or 6 % of several objects.
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

    def depths_of_solids_m(
        self,
        corner: Scene,
        shape: Shape,
        axes: NDArray[np.float64],
        centres_m: NDArray[np.float64],
        sizes_m: NDArray[np.float64],
        rays: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """(N, P) mirror images, as of `mirrored_depth_m`, of N solids of one shape in one corner.

        `axes` (N, 3, 3) are their own axes as columns in world axes; places and extents are (N, 3).
        """
        ready = self._world.scenes([corner], self._frequencies_hz)
        camera, origin = ready.corners.axes[0], ready.corners.origin[0]
        cell = self._world.cells[shape]
        solids = rows_of(shape, cell, camera @ axes, (centres_m - origin) @ camera.T, sizes_m)
        parts = [depths_of_solids_m(ready, part, rays) for part in _divided(solids, len(rays))]
        return np.concatenate(parts).astype(np.float64)

    def sees_wall(self, scenes: Sequence[Scene], rays: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(N, P) whether the cameras see their relay walls along (P, 3) rays, past the middle walls."""
        corners = Corners.of(scenes)
        film = rays / rays[:, 2:]
        of_wall = (corners.relay.inequalities @ film.T >= 0).all(axis=1)
        hidden = (corners.hiding @ film.T >= 0).all(axis=1)
        found: NDArray[np.bool_] = of_wall & ~hidden
        return found

    def direct(self, scenes: Sequence[Scene], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, P) direct light of N relay walls along (P, 3) rays, over that of the projector."""
        ready = self._world.scenes(scenes, self._frequencies_hz)
        return direct(ready, _seen(ready, rays)).reshape(len(scenes), len(rays))

    def _over_direct(
        self, scenes: Sequence[Scene], rays: NDArray[np.float64], fine: bool
    ) -> NDArray[np.complex128]:
        count = len(scenes)
        ready, every = self._world.scenes(scenes, self._frequencies_hz), np.arange(count)
        surface = np.array([first_level(scene) for scene in scenes]) + fine * _FINER
        levels = surface, np.full(count, _FILM_LEVELS[fine])
        found, _ = ratios(ready, every, *levels, _seen(ready, rays), self._world.meshes)
        return found.reshape(count, len(rays), -1)


def _seen(scenes: Scenes, rays: NDArray[np.float64]) -> Nodes:
    """Places on the relay walls of N scenes along the same (P, 3) rays."""
    count = len(scenes.scenes)
    film = np.broadcast_to(rays[:, :2] / rays[:, 2:], (count, len(rays), 2))
    places = on_wall(scenes.corners, film).reshape(-1, 3)
    return Nodes.of(count, np.repeat(np.arange(count), len(rays)), places)


def _divided(scenes: _Parted, pixels: int) -> list[_Parted]:
    """Scenes, or solids, in parts that fit into memory."""
    at_once = max(1, _AT_ONCE // pixels)
    return [scenes[start : start + at_once] for start in range(0, len(scenes), at_once)]
