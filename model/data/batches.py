"""Batches: network input and ground truth on the computing device, made from rows of the shards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from itof.sensor.binned import BinnedCamera
from itof.sensor.settings import SensorSettings
from itof.wall.expected_wall import ExpectedWall
from model.data.rows import ARRAYS, RowBlock
from model.data.scene_walls import SceneWalls
from model.data.sensor_draws import SensorDraws
from model.network.channels import IMAGES_AT_ONCE, InputSpec


@dataclass(frozen=True)
class Batch:
    """Network input and ground truth of N scenes, on one device, float32.

    Attributes
    ----------
    channels : (N, C, H, W) input channels.
    target : (N, 2, H, W) true Re and Im of the mirrored scene.
    radial_depth_m : (N, H, W) true radial depth, metres, 0 on background.
    mask : (N, H, W) true mask, 0 or 1.
    """

    channels: Tensor
    target: Tensor
    radial_depth_m: Tensor
    mask: Tensor


@dataclass(frozen=True)
class BatchMaker:
    """Makes batches from rows of the shards, on one device.

    Attributes
    ----------
    inputs : input channels and their constants.
    places : indices of the network's frequencies in those of the shards.
    wall : the relay wall at the network's frequencies, with its direct return in complex64.
    camera : measures the images; None if the network sees them as rendered.
    walls : the walls of the scenes, if these have different fields of view; None if all have `wall`.
    """

    inputs: InputSpec
    places: tuple[int, ...]
    wall: ExpectedWall
    camera: SensorDraws | None = None
    walls: SceneWalls | None = None

    @classmethod
    def for_shards(
        cls,
        inputs: InputSpec,
        frequencies_hz: Sequence[float],
        wall: ExpectedWall,
        device: torch.device,
        sensor: SensorSettings | None = None,
        *,
        sensor_capture: bool = False,
        walls: SceneWalls | None = None,
    ) -> BatchMaker:
        """The maker for shards with these frequencies, Hz, that show this wall (numpy arrays).

        `walls` are those of the scenes, at the network's frequencies, if these have different fields of view.

        Raises
        ------
        ValueError : the images are no binned images of the sensor.
        """
        places = tuple(inputs.places(frequencies_hz))
        seen = wall.at(places)
        seen = replace(seen, direct=seen.direct.astype(np.complex64))
        here = _on(device, seen)
        if sensor is None:
            return cls(inputs, places, here, walls=walls)
        height, width = seen.direct.shape[:2]
        camera = BinnedCamera(sensor, inputs.frequencies_hz, width, height)
        return cls(inputs, places, here, SensorDraws(camera, here.direct if sensor_capture else None))

    def upload(self, block: RowBlock) -> RowBlock:
        """A copy of `block` on the device, as tensors, with the reference of every image.

        Its phasors are those of the network's frequencies, as rendered, or as the camera measures them; the
        number of a row then decides its noise.
        """
        rows = self._on_device(block)
        if self.camera is not None:
            parts = [self.camera(rows.phasors[some], rows.rows[some]) for some in _parts(rows)]
            rows = replace(rows, phasors=torch.cat(parts))
        return replace(rows, reference=self._references(rows)) if self.inputs.uses_residual else rows

    def upload_to_augment(self, block: RowBlock) -> RowBlock:
        """A copy of `block` on the device, as tensors, with phasors as rendered.

        Without a camera it has the reference of every image: that of the phasors as rendered, because noise
        of the augmentation would hardly change it. With a camera, each measurement has its own, which `batch`
        finds.
        """
        return self.upload(block) if self.camera is None else self._on_device(block)

    def _on_device(self, block: RowBlock) -> RowBlock:
        phasors = np.take(block.phasors, self.places, axis=-1)  # contiguous, which indexing is not
        arrays = {name: getattr(block, name) for name in ARRAYS} | {"phasors": phasors}
        device = self.wall.rays.device
        tensors = {name: torch.from_numpy(array).to(device) for name, array in arrays.items()}
        return RowBlock(block.rows, **tensors, fields_of_view_deg=block.fields_of_view_deg)

    @property
    def reference_bytes(self) -> int:
        """Memory of an image's reference, which `upload` adds to its row, bytes."""
        pixels = self.wall.direct[..., 0].nbytes
        return int(pixels * self.inputs.reference_count)

    def _references(self, rows: RowBlock) -> Tensor:
        """(n, H, W, F or F + 1) complex64 reference of uploaded rows."""
        shape = (len(rows), *self.wall.direct.shape[:-1], self.inputs.reference_count)
        found = torch.empty(shape, dtype=torch.complex64, device=self.wall.rays.device)
        for some in _parts(rows):
            measured = rows.phasors[some]
            views_deg = rows.fields_of_view_deg
            wall = self.wall
            if self.walls is not None and views_deg is not None:
                wall = _on(found.device, self.walls.of(views_deg[some].tolist()))
            found[some] = self.inputs.reference_of_image(measured, wall)
        return found

    def reference(self, phasor: Tensor) -> Tensor | None:
        """The reference of phasors (N, H, W, F); None if the network needs none."""
        if not self.inputs.uses_residual:
            return None
        found: Tensor = self.inputs.reference_of_image(phasor, self.wall)
        return found

    def batch(self, rows: RowBlock, phasor: Tensor | None = None) -> Batch:
        """Input channels and ground truth of uploaded rows; rows without a reference get that of `phasor`.

        Parameters
        ----------
        phasor : (N, H, W, F) complex; replaces the phasors of `rows` if it is given.
        """
        measured = rows.phasors if phasor is None else phasor
        known = self.reference(measured) if rows.reference is None else rows.reference
        return Batch(
            channels=self.inputs.apply(measured, known, is_weighted=True),
            target=torch.stack([rows.target.real, rows.target.imag], dim=1),
            radial_depth_m=rows.radial_depth_m,
            mask=rows.mask.float(),
        )


def _parts(rows: RowBlock) -> list[slice]:
    """The images that are computed at once."""
    return [slice(start, start + IMAGES_AT_ONCE) for start in range(0, len(rows), IMAGES_AT_ONCE)]


def _on(device: torch.device, wall: ExpectedWall) -> ExpectedWall:
    return wall.converted(lambda array: torch.from_numpy(array).to(device))
