"""Training on several GPUs or machines: the processes that torchrun starts, or a single one."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from disk import NightError
from model.device import DeviceError, choose_device
from model.settings.run import DeviceName

# Gloo's threads release the tensors of the last sum a little after it is done, and need the interpreter for
# that. An interpreter that ends before that aborts the process, so it waits.
_GLOO_WAIT_S = 0.1


class ProcessError(NightError):
    """The processes of a run have lost each other."""


@dataclass(frozen=True)
class Processes:
    """The processes of a run.

    Attributes
    ----------
    device : device of this process.
    rank : index of this process.
    count : number of processes.
    """

    device: torch.device
    rank: int = 0
    count: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and shows progress."""
        return self.rank == 0

    def share(self, rows: Sequence[int]) -> list[int]:
        """Rows of a batch for this process; at least one, because all processes take part in every step.

        If a batch has fewer rows than there are processes, the others borrow its first row. A borrowed row
        has weight 0 (`own`).
        """
        return list(rows[self.rank :: self.count]) or list(rows[:1])

    def own(self, batch_size: int) -> int:
        """Number of rows of a batch that belong to this process, without a borrowed one."""
        return len(range(self.rank, batch_size, self.count))

    def parallel(self, network: nn.Module) -> nn.Module:
        """The network, with its gradients averaged over all processes."""
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
        """Minimum of `number` over all processes."""
        smallest = torch.tensor(number, device=self.device)
        if self.count > 1:
            distributed.all_reduce(smallest, distributed.ReduceOp.MIN)
        return int(smallest)

    def any(self, flag: bool) -> bool:
        """Whether `flag` is set in any process."""
        if self.count == 1:
            return flag
        return bool(self.total(torch.tensor(float(flag), device=self.device)) > 0)

    @contextmanager
    def first_one_first(self) -> Iterator[None]:
        """Context that the other processes enter after the first process has left it."""
        if self.count > 1 and not self.is_first:
            distributed.barrier()
        yield
        if self.count > 1 and self.is_first:
            distributed.barrier()


def processes_of_this_machine() -> int:
    """Number of processes of the run on this machine, which share its memory."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))


def is_first_process() -> bool:
    """Whether this process should print: it is the only one, or the first that torchrun started."""
    return int(os.environ.get("RANK", "0")) == 0


@contextmanager
def joined_processes(device_name: DeviceName) -> Iterator[Processes]:
    """Connect to the other processes that torchrun started; without torchrun there is only this one.

    The environment variables of torchrun tell which case it is. On GPUs, each process uses the GPU of its
    local rank and they communicate by NCCL; on CPUs, they communicate by Gloo.

    Raises
    ------
    DeviceError : the device does not exist, or this machine has more processes than GPUs.
    ProcessError : the processes cannot connect, or one of the others has ended.
    """
    device = choose_device(device_name)
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield Processes(device)
        return
    if device.type == "cuda":
        device = _own_gpu()
    _connect("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Processes(device, distributed.get_rank(), count)
    except RuntimeError as error:  # Gloo has no exception of its own
        if not isinstance(error, distributed.DistError) and "gloo" not in str(error):
            raise
        raise ProcessError("another process of this training has ended: see what it printed") from None
    finally:
        distributed.destroy_process_group()
        time.sleep(_GLOO_WAIT_S)


def _own_gpu() -> torch.device:
    """The GPU of this process's local rank."""
    rank, count = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
    if rank >= count:
        raise DeviceError(f"every process needs a GPU of its own: give torchrun --nproc-per-node {count}")
    device = torch.device("cuda", rank)
    torch.cuda.set_device(device)
    return device


def _connect(backend: str) -> None:
    """Join the process group; the timeout is long because the others wait while the first builds shards."""
    try:
        distributed.init_process_group(backend, timeout=timedelta(hours=6))
    except (RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ProcessError(
            f"the processes of this training cannot connect ({reason}): start them with torchrun"
        ) from None
