"""How much memory this machine has, and whether an array can be held in it.

A header of a few bytes can claim an array of any size. The claim is compared with the memory of the machine
before the array is read. Otherwise the process would be killed, or end in an error about memory.
"""

from __future__ import annotations

import os
from pathlib import Path

LARGEST_PART = 0.5  # of the machine's memory that the arrays of one file may take
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def machine_bytes() -> int:
    """Memory of this machine or container, bytes."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for name in _CONTAINER_LIMITS:
        try:
            total = min(total, int(Path(name).read_text(encoding="ascii")))
        except (OSError, ValueError):  # no such control group, or "max"
            continue
    return total


def memory_shortage(count: int, *, copies: int = 1) -> str | None:
    """Why arrays of `count` bytes are not read on this machine, as a predicate; None if they fit.

    Parameters
    ----------
    copies : how many copies of the arrays are in memory at a time.
    """
    total = machine_bytes()
    if copies * count <= LARGEST_PART * total:
        return None
    return (
        f"claims {binary_size(count)} of memory, and this machine has {binary_size(total)} "
        f"(at most {LARGEST_PART / copies:.0%} of it may be claimed)"
    )


def binary_size(count: float) -> str:
    """A number of bytes with its unit, like ``21.8 TiB``."""
    for unit in ("bytes", "KiB", "MiB", "GiB", "TiB", "PiB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1024
    return "more than 1000 PiB"
