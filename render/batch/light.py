"""The light of three bounces of many scenes: hidden and direct return, and the mirrored depth map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from render.backend import Device
from render.batch.hidden import HiddenRatios
from render.batch.tables import Scenes, World
from render.walls.pixel_lines import PixelLines
from scenegen.scene import Scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

BOUNCES: Final = 3  # of the light
_LEAST_ROUGHNESS: Final = 0.05  # of a wall: film and lattice are too coarse for the gloss of smoother ones
Phasors = NDArray[np.complex64]


@dataclass(frozen=True)
class LightImages:
    """The light of N scenes.

    Attributes
    ----------
    direct, hidden : (N, H, W, F) complex64, mean radiance of each pixel, W m^-2 sr^-1.
    radial_depth_m : (N, H, W) float32 depth of the mirror image of the objects, 0 beside it.
    error : (N,) upper bound of the error of `hidden`, relative to it; it holds in 95 % of scenes.
    """

    direct: Phasors
    hidden: Phasors
    radial_depth_m: NDArray[np.float32]
    error: NDArray[np.float64]

    def of(self, scene: int) -> SceneLight:
        """The light of one of the scenes."""
        arrays = (self.direct[scene], self.hidden[scene], self.radial_depth_m[scene])
        return SceneLight(*arrays, float(self.error[scene]))


@dataclass(frozen=True)
class SceneLight:
    """The light of one scene, as that of N in `LightImages`."""

    direct: Phasors
    hidden: Phasors
    radial_depth_m: NDArray[np.float32]
    error: float


def suits(scene: Scene) -> bool:
    """Whether the engine can render a scene with three bounces: its projector is a flash at the camera."""
    roughness = scene.relay_wall.roughness
    return scene.has_flash and (roughness is None or roughness >= _LEAST_ROUGHNESS)


class BatchedLight:
    """Renders scenes with at most three bounces, all with the same image size and frequencies.

    Parameters
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    width, height : of the images, pixels.
    error : wanted error of the hidden light, relative to it.
    meshes : the user's meshes that the scenes have, by shape.
    device : ``auto``, ``cpu`` or ``cuda``.
    threads : of DrJit on the CPU, in this process; None keeps their number.

    Raises
    ------
    BackendError : this machine cannot render on the requested device.
    """

    def __init__(
        self,
        frequencies_hz: Sequence[float],
        width: int,
        height: int,
        *,
        error: float,
        meshes: Mapping[Shape, UnitMesh] | None = None,
        device: Device = "auto",
        threads: int | None = None,
    ) -> None:
        self.frequencies_hz, self.size, self.error = tuple(frequencies_hz), (width, height), error
        self._world = World(meshes, device, threads)
        self._hidden = HiddenRatios(self._world.meshes, width, height, error)

    def images(self, scenes: Sequence[Scene]) -> LightImages:
        """The light of scenes; each is the same in any batch."""
        ready = self._world.scenes(scenes, self.frequencies_hz)
        over_direct, error = self._hidden.of(ready)
        direct = self._direct(ready)
        return LightImages(direct, direct * over_direct, self._depth(ready), error)

    def _direct(self, scenes: Scenes) -> Phasors:
        """(N, H, W, F) direct return."""
        import drjit as dr
        import mitsuba as mi

        from render.batch.kernels import images as kernels
        from render.transport.kernels.arrays import upload, upload_indices

        (width, height), corners, count = self.size, scenes.corners, len(scenes.scenes)
        pixels = PixelLines.of(corners, width, height)
        scene, _, column = self._pixels(count)
        size = dr.gather(mi.Float, upload(2 * corners.half / width), scene)
        left = (mi.Float(column) - dr.opaque(mi.Float, width / 2)) * size
        ends = (upload_indices(each) for each in (pixels.first, pixels.last))
        sums = kernels.direct_return(scenes.batch, scene, left, size, upload(pixels.lines), *ends)
        dr.eval(sums)
        power = np.pi * np.array([each.emitter.irradiance for each in scenes.scenes])
        direct = np.empty((count, height, width, len(self.frequencies_hz)), np.complex64)
        for place, (re, im) in enumerate(zip(*sums, strict=True)):
            direct[..., place].real, direct[..., place].imag = (
                np.array(each).reshape(count, height, width) * power[:, None, None] for each in (re, im)
            )
        return direct

    def _depth(self, scenes: Scenes) -> NDArray[np.float32]:
        """(N, H, W) radial depth of the mirror images."""
        (width, height), count = self.size, len(scenes.scenes)
        columns, rows = scenes.corners.pixel_centres(width, height)
        film = np.ones((count, height, width, 3))
        film[..., 0], film[..., 1] = columns[:, None], rows[..., None]
        depth = mirrored_depth_m(scenes, film.reshape(count, -1, 3))
        return depth.reshape(count, height, width)

    def _pixels(self, count: int) -> tuple[Any, Any, Any]:
        """Scene, row and column of the pixels of `count` images."""
        import drjit as dr
        import mitsuba as mi

        width, height = (dr.opaque(mi.UInt32, side) for side in self.size)
        pixel = dr.arange(mi.UInt32, count * self.size[0] * self.size[1])
        scene = pixel // (width * height)
        inside = pixel - scene * (width * height)
        row = inside // width
        return scene, row, inside - row * width


def mirrored_depth_m(scenes: Scenes, towards: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, P) radial depth of the mirror images of N scenes along directions (N, P, 3) of each, metres.

    0 beside them.
    """
    import drjit as dr
    import mitsuba as mi

    from render.batch.kernels import images as kernels
    from render.transport.kernels.arrays import upload_indices, upload_points

    count, pixels = towards.shape[:2]
    scene = upload_indices(np.repeat(np.arange(count), pixels))
    ends = (
        dr.gather(mi.UInt32, upload_indices(each), scene)
        for each in (scenes.first_object[:-1], scenes.first_object[1:])
    )
    occluders = upload_indices(np.array([each.mirror_occluders for each in scenes.scenes]))
    has_wall = dr.gather(mi.UInt32, occluders, scene) > 0
    rays = dr.normalize(mi.Vector3f(upload_points(towards.reshape(-1, 3))))
    depth = kernels.mirrored_depth(scenes.batch, scene, rays, *ends, has_wall)
    dr.eval(depth)
    return np.array(depth).reshape(count, pixels)


def depths_of_solids_m(
    corner: Scenes, solids: NDArray[np.float64], towards: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(N, P) as `mirrored_depth_m`, of N solids (N, 6, 4) in the corner of one scene.

    The directions (P, 3) are the same for all; `solids` are the rows of `kernels.shadows.Shadows`.
    """
    import drjit as dr
    import mitsuba as mi

    from render.batch.kernels import images as kernels
    from render.transport.kernels.arrays import upload, upload_indices, upload_points

    count = len(solids)
    solid = upload_indices(np.repeat(np.arange(count), len(towards)))
    batch = corner.batch.with_objects(upload(solids))
    scene = dr.zeros(mi.UInt32, count * len(towards))
    rays = dr.normalize(mi.Vector3f(upload_points(np.tile(towards, (count, 1)))))
    has_wall = scene < dr.opaque(mi.UInt32, int(corner.scenes[0].mirror_occluders))
    depth = kernels.mirrored_depth(batch, scene, rays, solid, solid + 1, has_wall)
    dr.eval(depth)
    return np.array(depth).reshape(count, len(towards))
