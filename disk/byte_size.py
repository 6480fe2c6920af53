"""Numbers of bytes as text."""

from __future__ import annotations


def size(count: float) -> str:
    """Bytes in a suitable unit from bytes to TB, with three digits, like ``1.23 GB``."""
    for unit in ("bytes", "kB", "MB", "GB", "TB"):
        if count < 999.5 or unit == "TB":
            break
        count /= 1000
    return f"{count:.0f} {unit}" if count >= 999.5 else f"{count:.3g} {unit}"


def binary_size(count: float) -> str:
    """A number of bytes with its unit, like ``21.8 TiB``."""
    for unit in ("bytes", "KiB", "MiB", "GiB", "TiB", "PiB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1024
    return "more than 1000 PiB"
