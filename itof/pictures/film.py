"""Films: pictures one after the other, as an animated GIF or WebP file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

FILM_ENDINGS: Final = (".gif", ".webp")
_SHORTEST_MS, _LONGEST_MS = 20, 600_000  # of a frame that browsers show as long as it says


def encode_film(path: Path, pictures: Iterator[Picture], frames_per_second: float) -> None:
    """Write pictures of equal size as a film that repeats without end; at most 50 of them a second.

    The ending of the path, one of `FILM_ENDINGS`, says the format.
    """
    duration_ms = min(max(round(1000 / frames_per_second), _SHORTEST_MS), _LONGEST_MS)
    next(pictures).save(path, save_all=True, append_images=pictures, duration=duration_ms, loop=0)
