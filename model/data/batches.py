"""Scenes as tensors on the computing device: rows of the shards, and the batches made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from model.data.rows import RowBlock
from model.network.channels import InputSpec

_TENSORS = ("phasor", "target", "radial_depth_m", "mask")


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
class TensorRows:
    """Rows of the shards on one device, as `model.RowBlock` is in memory.

    Attributes
    ----------
    rows : n row numbers, in the order of the tensors.
    phasor : (n, H, W, F) complex64, at the network's frequencies.
    target, radial_depth_m : (n, 2, H, W) and (n, H, W) float32.
    mask : (n, H, W) uint8.
    """

    rows: tuple[int, ...]
    phasor: Tensor
    target: Tensor
    radial_depth_m: Tensor
    mask: Tensor

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, rows: Sequence[int]) -> TensorRows:
        """A copy of some of the rows, in the order asked for."""
        places = torch.tensor([self._places[row] for row in rows], device=self.mask.device)
        return TensorRows(tuple(rows), *(getattr(self, name)[places] for name in _TENSORS))

    def joined(self, other: TensorRows) -> TensorRows:
        """These rows and then the other's."""
        both = (torch.cat([getattr(self, name), getattr(other, name)]) for name in _TENSORS)
        return TensorRows(self.rows + other.rows, *both)

    @cached_property
    def _places(self) -> dict[int, int]:
        return {row: place for place, row in enumerate(self.rows)}


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

    def upload(self, block: RowBlock) -> TensorRows:
        """Rows that were read, on the device."""
        device, count = self.reference.device, block.phasors.shape[1] // 2  # components come in twos
        parts = [
            torch.from_numpy(block.phasors[:, [first + place for place in self.places]]).to(device)
            for first in (0, count)
        ]
        return TensorRows(
            block.rows,
            torch.complex(*parts).movedim(1, -1).contiguous(),  # (n, H, W, F)
            *(
                torch.from_numpy(array).to(device)
                for array in (block.target, block.radial_depth_m, block.mask)
            ),
        )

    def batch(self, rows: TensorRows, phasor: Tensor | None = None) -> Batch:
        """Network channels and ground truth of `rows`; `phasor` (N, H, W, F) instead of the measured one."""
        return Batch(
            channels=self.inputs.apply(rows.phasor if phasor is None else phasor, self.reference),
            target=rows.target,
            radial_depth_m=rows.radial_depth_m,
            mask=rows.mask.float(),
        )
