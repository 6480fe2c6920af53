"""What is fitted to images that are read in every epoch, found once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from itof.wall.expected_wall import ExpectedWall
from itof.wall.self_calibration import FittedWall
from model.network.channels import InputSpec


class WallFits:
    """Wall and phases of the images of rows; fits take more than half of the time of an upload.

    A row must have the same image each time.

    Parameters
    ----------
    inputs : input channels of the network, which self-calibrate.
    """

    def __init__(self, inputs: InputSpec) -> None:
        self._inputs = inputs
        self._of_row: dict[int, Tensor] = {}  # (3 + F or 3 + 3F) float64: plane, offsets and waves

    def of(self, rows: Sequence[int], phasor: Tensor, wall: ExpectedWall) -> FittedWall:
        """The fits of rows with the phasors (n, H, W, F)."""
        if not all(row in self._of_row for row in rows):
            fit = self._inputs.fit_of(phasor, wall)
            parts = [fit.plane_per_m, fit.offsets_rad]
            if fit.wiggling_rad is not None:
                parts.append(fit.wiggling_rad.flatten(-2))
            each = torch.cat(parts, dim=-1).cpu()  # where a small tensor takes little more than its bytes
            self._of_row |= dict(zip(rows, each.unbind(), strict=True))
        count = phasor.shape[-1]
        known = torch.stack([self._of_row[row] for row in rows]).to(phasor.device)
        plane, offsets, waves = (part.contiguous() for part in known.tensor_split((3, 3 + count), dim=-1))
        return FittedWall(plane, offsets, waves.unflatten(-1, (count, 2)) if waves.numel() else None)
