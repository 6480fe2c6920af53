"""The computing device and its threads, and the number type of the network's convolutions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits

from disk import NightError
from model.settings.run import DeviceName, Precision


class DeviceError(NightError):
    """The requested device does not exist on this machine."""


def choose_device(name: DeviceName) -> torch.device:
    """The device to compute on; ``auto`` takes a GPU if there is one.

    On a GPU, float32 is float32 from then on: PyTorch would let convolutions round their input to TF32, whose
    11 significant bits cannot hold the hidden 0.2 % of a phasor.

    Raises
    ------
    DeviceError : ``cuda`` is requested and PyTorch finds no CUDA device.
    """
    has_gpu = torch.cuda.is_available()
    if name == "cuda" and not has_gpu:
        raise DeviceError("there is no CUDA device that PyTorch can use: choose device cpu or auto")
    if name == "cpu" or not has_gpu:
        return torch.device("cpu")
    torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = False
    return torch.device("cuda")


@contextmanager
def plain_memory_errors() -> Iterator[None]:
    """Turn the out-of-memory errors of PyTorch into Python's `MemoryError`; on the CPU they have no type."""
    try:
        yield
    except RuntimeError as error:
        if isinstance(error, torch.OutOfMemoryError) or "alloc_cpu.cpp" in str(error):
            raise MemoryError from None
        raise


def number_type(precision: Precision, device: torch.device) -> torch.dtype:
    """Number type of the convolutions in training.

    ``auto`` is bfloat16 if `device` computes in it natively, else float32.
    """
    if precision == "auto":
        able = torch.cpu.get_capabilities()
        fast = able.get("avx512_bf16") or able.get("amx_bf16")
        if device.type == "cuda":
            fast = torch.cuda.is_bf16_supported(including_emulation=False)
        precision = "bfloat16" if fast else "float32"
    return {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}[precision]


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch and numpy use one thread: faster for small arrays, and sums depend on their number."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
