"""How much memory this machine has, and whether an array can be held in it.

A header of a few bytes can claim an array of any size. The claim is compared with the memory of the machine
before the array is read. Otherwise the process would be killed, or end in an error about memory.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path, PurePosixPath

from disk.byte_size import binary_size

LARGEST_PART = 0.5  # of the machine's memory that the arrays of one file may take
_GROUPS = Path("/sys/fs/cgroup")


def machine_bytes() -> int:
    """Memory of this machine, container or job of a batch system, bytes."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for file in _limits_of_this_process():
        try:
            total = min(total, int(file.read_text(encoding="ascii")))
        except (OSError, ValueError):  # no such control group, or "max"
            continue
    return total


def limit_files(groups: str) -> list[Path]:
    """Files with the memory limits of control groups and all groups above them.

    Parameters
    ----------
    groups : contents of ``/proc/self/cgroup``, lines ``ID:CONTROLLERS:PATH``; version 2 names no controllers.
    """
    found = [_GROUPS / "memory.max", _GROUPS / "memory" / "memory.limit_in_bytes"]
    for line in groups.splitlines():
        _, controllers, place = (*line.split(":", 2), "", "")[:3]
        if controllers and "memory" not in controllers.split(","):
            continue
        top, name = (_GROUPS / "memory", "memory.limit_in_bytes") if controllers else (_GROUPS, "memory.max")
        inner = PurePosixPath(place.lstrip("/"))
        found += [top / group / name for group in (inner, *inner.parents) if ".." not in group.parts]
    return list(dict.fromkeys(found))


@cache
def _limits_of_this_process() -> list[Path]:
    try:
        groups = Path("/proc/self/cgroup").read_text(encoding="utf-8")
    except (OSError, ValueError):
        groups = ""
    return [file for file in limit_files(groups) if file.is_file()]


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
