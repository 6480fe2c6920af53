"""Rows of a wall with hidden light, as the augmentation and a camera get them."""

import numpy as np
import torch

from itof import direct_phasors, phase_per_metre
from itof.wall.expected_wall import ExpectedWall
from model.data.augmentation import Draws
from model.data.batches import Batch, BatchMaker
from model.data.rows import RowBlock
from model.network.channels import InputSpec

HEIGHT, WIDTH = 6, 10
FREQUENCIES_HZ = (20e6, 50e6)
FACING_THE_WALL = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])


def batch_of(count: int = 2, height: int = HEIGHT, width: int = WIDTH) -> Batch:
    generator = torch.Generator().manual_seed(0)
    mask = (torch.rand(count, height, width, generator=generator) < 0.3).float()
    target = torch.randn(count, 2, height, width, generator=generator) * mask[:, None]
    return Batch(
        torch.randn(count, 3, height, width, generator=generator), target, 3 * target[:, 0].abs(), mask
    )


def draws_of(count: int, seed: int = 0) -> Draws:
    return Draws.of(count, torch.Generator().manual_seed(seed))


def measured_rows(count: int = 5) -> tuple[RowBlock, BatchMaker, np.ndarray, np.ndarray]:
    """Rows of a wall with hidden light, their maker, and phasors and direct return as numpy arrays."""
    rng = np.random.default_rng(2)
    args = (WIDTH, HEIGHT, 60.0, FREQUENCIES_HZ, FACING_THE_WALL, (0, 0, 0), (0, 0, 2), (0, 0, 1))
    direct = direct_phasors(*args)
    opl_m = rng.uniform(6, 9, (count, HEIGHT, WIDTH, 1))
    phasor = direct + 2e-3 * np.abs(direct) * np.exp(1j * opl_m * phase_per_metre(FREQUENCIES_HZ))
    spec = InputSpec("paper+residual", FREQUENCIES_HZ, 0.3, (1e-3, 2e-3, 3e-3), "measured")
    wall = ExpectedWall.of_camera(direct, FREQUENCIES_HZ, *args[2:3], *args[4:])
    maker = BatchMaker.for_shards(spec, FREQUENCIES_HZ, wall, torch.device("cpu"))
    truth = batch_of(count)
    rows = RowBlock(
        tuple(range(count)),
        torch.from_numpy(phasor.astype(np.complex64)),
        torch.complex(*truth.target.unbind(1)),
        *(truth.radial_depth_m, truth.mask.to(torch.uint8)),
    )
    return rows, maker, phasor, direct
