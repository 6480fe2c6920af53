"""Numbers of bytes in words."""

from __future__ import annotations


def size(count: float) -> str:
    """Bytes as people write them, to three digits."""
    for unit in ("bytes", "kB", "MB", "GB", "TB"):
        if count < 999.5 or unit == "TB":
            break
        count /= 1000
    return f"{count:.0f} {unit}" if count >= 999.5 else f"{count:.3g} {unit}"
