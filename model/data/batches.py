"""Batches: what the network is fed and judged by, made of rows of the shards on the computing device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from model.data.rows import ARRAYS, RowBlock
from model.network.channels import InputSpec


@dataclass(frozen=True)
class Batch:
    """Network input and ground truth of some scenes, on one device, float32.

    Attributes
    ----------
    channels : (N, C, H, W) network input.
    target : (N, 2, H, W) Re and Im of the mirrored scene.
    radial_depth_m : (N, H, W) true depth, 0 on background.
    mask : (N, H, W) true mask, 0 or 1.
    """

    channels: Tensor
    target: Tensor
    radial_depth_m: Tensor
    mask: Tensor


@dataclass(frozen=True)
class BatchMaker:
    """From rows of the shards to network channels, all on one device.

    Attributes
    ----------
    inputs : which channels, how scaled.
    places : of the network's frequencies among those of the shards.
    reference : (H, W, F) complex64, direct return of the bare relay wall at the network's frequencies.
    """

    inputs: InputSpec
    places: tuple[int, ...]
    reference: Tensor

    @classmethod
    def for_shards(
        cls,
        inputs: InputSpec,
        frequencies_hz: Sequence[float],
        reference: NDArray[np.complex128],
        device: torch.device,
    ) -> BatchMaker:
        """The maker for shards that hold these frequencies and this (H, W, F) direct return."""
        places = tuple(inputs.places(frequencies_hz))
        known = torch.from_numpy(reference[..., places].astype(np.complex64))
        return cls(inputs, places, known.to(device))

    def upload(self, block: RowBlock) -> RowBlock:
        """Rows that were read, as tensors on the device, with the phasors of the network's frequencies."""
        count = block.phasors.shape[1] // 2  # real and imaginary parts
        chosen = [first + place for first in (0, count) for place in self.places]
        arrays = {name: getattr(block, name) for name in ARRAYS} | {"phasors": block.phasors[:, chosen]}
        device = self.reference.device
        return RowBlock(block.rows, **{n: torch.from_numpy(array).to(device) for n, array in arrays.items()})

    def measured(self, rows: RowBlock) -> Tensor:
        """(N, H, W, F) complex64 phasors of uploaded rows."""
        phasor: Tensor = rows.complex_phasors().contiguous()  # of a strided tensor, PyTorch rounds |z| otherwise
        return phasor

    def batch(self, rows: RowBlock, phasor: Tensor | None = None) -> Batch:
        """Network channels and ground truth of uploaded rows.

        `phasor` (N, H, W, F), where it is given, replaces the measured one.
        """
        measured = self.measured(rows) if phasor is None else phasor
        return Batch(
            channels=self.inputs.apply(measured, self.reference),
            target=rows.target,
            radial_depth_m=rows.radial_depth_m,
            mask=rows.mask.float(),
        )
