"""How many cores this process has."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Cores that this process may run on; those of the machine where the system does not say (macOS)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
