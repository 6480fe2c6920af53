"""What is fitted to images that are read in every epoch, found once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_fit import WallFit
from model.network.channels import InputSpec


class FitCache:
    """Wall and phases of the images of rows; fits take more than half of the time of an upload.

    A row must have the same image each time. On the CPU, each image is fitted alone, because the rounding of
    several at once depends on which they are, and a resumed run fits others together.

    Parameters
    ----------
    inputs : input channels of the network, which self-calibrate.
    """

    def __init__(self, inputs: InputSpec) -> None:
        self._inputs = inputs
        self._of_row: dict[int, Tensor] = {}  # (3 + F or 3 + 3F) float64: plane, offsets and waves

    def of(self, rows: Sequence[int], phasor: Tensor, wall: ExpectedWall) -> WallFit:
        """The fits of rows with the phasors (n, H, W, F)."""
        at_once = 1 if phasor.device.type == "cpu" else len(rows)
        for start in range(0, len(rows), at_once):
            some = slice(start, start + at_once)
            if not all(row in self._of_row for row in rows[some]):
                found = self._fitted(phasor[some], wall.of_images(some))
                self._of_row |= dict(zip(rows[some], found.unbind(), strict=True))
        count = phasor.shape[-1]
        known = torch.stack([self._of_row[row] for row in rows]).to(phasor.device)
        plane, offsets, waves = (part.contiguous() for part in known.tensor_split((3, 3 + count), dim=-1))
        return WallFit(plane, offsets, waves.unflatten(-1, (count, 2)) if waves.numel() else None)

    def _fitted(self, phasor: Tensor, wall: ExpectedWall) -> Tensor:
        """(n, 3 + F or 3 + 3F) fits of (n, H, W, F) phasors, on the CPU."""
        fit = self._inputs.fit_of(phasor, wall)
        parts = [fit.plane_per_m, fit.offsets_rad]
        if fit.wiggling_rad is not None:
            parts.append(fit.wiggling_rad.flatten(-2))
        return torch.cat(parts, dim=-1).cpu()  # where a small tensor takes little more than its bytes
