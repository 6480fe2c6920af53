"""The computing device, and the number type of the network's convolutions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from model.settings import DeviceName, Precision
from scenegen import NightError


class DeviceError(NightError):
    """The requested device does not exist on this machine."""


def choose_device(name: DeviceName) -> torch.device:
    """The device to compute on; ``auto`` takes a GPU if there is one.

    Raises
    ------
    DeviceError : ``cuda`` is requested and PyTorch finds no CUDA device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise DeviceError("there is no CUDA device that PyTorch can use: choose device cpu or auto")
    return torch.device(name)


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
