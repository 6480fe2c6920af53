"""One training on several GPUs or machines: the processes that torchrun starts, or this one alone."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from model.device import choose_device
from model.settings import DeviceName


@dataclass(frozen=True)
class Processes:
    """The processes of a run.

    Attributes
    ----------
    device : that this one computes on.
    rank, count : which of them this one is, and how many there are.
    """

    device: torch.device
    rank: int = 0
    count: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this one writes files and shows progress."""
        return self.rank == 0

    def share(self, rows: Sequence[int]) -> list[int]:
        """Rows of a batch that are this process's; never none, so that all take part in every step.

        A batch with fewer rows than processes lends its first row to those that would have none; there it
        must count nothing (`own`).
        """
        return list(rows[self.rank :: self.count]) or list(rows[:1])

    def own(self, batch_size: int) -> int:
        """How many rows of a batch are this process's own, not lent."""
        return len(range(self.rank, batch_size, self.count))

    def parallel(self, network: nn.Module) -> nn.Module:
        """The network with gradients that are averaged over all processes."""
        if self.count == 1:
            return network
        return DistributedDataParallel(
            network, device_ids=[self.device] if self.device.type == "cuda" else None
        )

    def total(self, values: Tensor) -> Tensor:
        """Sum over all processes, float64."""
        values = values.to(torch.float64, copy=True)  # all_reduce works in place
        if self.count > 1:
            distributed.all_reduce(values)
        return values

    def smallest(self, number: int) -> int:
        """The smallest of the numbers that the processes have."""
        smallest = torch.tensor(number, device=self.device)
        if self.count > 1:
            distributed.all_reduce(smallest, distributed.ReduceOp.MIN)
        return int(smallest)

    def any(self, flag: bool) -> bool:
        """Whether the flag is set in any process."""
        if self.count == 1:
            return flag
        return bool(self.total(torch.tensor(float(flag), device=self.device)) > 0)

    @contextmanager
    def first_one_first(self) -> Iterator[None]:
        """Let the first process through a block before the others enter it."""
        if self.count > 1 and not self.is_first:
            distributed.barrier()
        yield
        if self.count > 1 and self.is_first:
            distributed.barrier()


def processes_of_this_machine() -> int:
    """How many processes of the run share this machine's memory."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))


def is_first_process() -> bool:
    """Whether this process should print: it is alone, or the first of those that torchrun started."""
    return int(os.environ.get("RANK", "0")) == 0


@contextmanager
def joined_processes(device_name: DeviceName) -> Iterator[Processes]:
    """The processes that torchrun started with this one (by the environment it sets), else this one alone.

    On GPUs each takes the one of its local rank and they talk by NCCL, on CPUs by gloo.

    Raises
    ------
    DeviceError : no such device.
    """
    device = choose_device(device_name)
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield Processes(device)
        return
    if device.type == "cuda":
        device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
        torch.cuda.set_device(device)
    # The others wait while the first one makes shards or writes a checkpoint.
    distributed.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=timedelta(hours=6))
    try:
        yield Processes(device, distributed.get_rank(), count)
    finally:
        distributed.destroy_process_group()
