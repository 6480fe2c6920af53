"""PNG files of matplotlib's figures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # matplotlib takes half a second to load
    from matplotlib.figure import Figure


def save_png(figure: Figure, file: Path, dots_per_inch: int, **options: Any) -> None:
    """Write a figure to a file, with other `options` of `savefig`."""
    with missing_letters_as_boxes():
        figure.savefig(file, format="png", dpi=dots_per_inch, **options)


@contextmanager
def missing_letters_as_boxes() -> Iterator[None]:
    """Draw a letter that the font lacks, as a file's name in a title may have, as a box without a warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        warnings.filterwarnings("ignore", "Matplotlib currently does not support .* natively", UserWarning)
        yield
