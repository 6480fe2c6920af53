"""Files of the pictures of a check: only a picture of an earlier check is replaced."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from disk import whole_file
from itof.capture.sidecar import CaptureError
from itof.pictures.png import save_png

if TYPE_CHECKING:  # matplotlib takes half a second to load
    from matplotlib.figure import Figure

DOTS_PER_INCH: Final = 150
_MARK: Final = "night-eval capture check"  # text in the head of our pictures
_PNG = b"\x89PNG\r\n\x1a\n"
_HEAD = 512  # bytes that hold the text: matplotlib writes it before the pixels


def write_picture(path: Path, figure: Figure) -> None:
    """Write a PNG file that `refuse_other_picture` knows again, whole or not at all."""
    with whole_file(path) as partial:
        save_png(figure, partial, DOTS_PER_INCH, metadata={"Software": None, "Source": _MARK})


def refuse_other_picture(path: Path) -> None:
    """Refuse to replace a file that no check has written.

    Raises
    ------
    CaptureError : there is something else at the path.
    """
    if not (path.exists() or path.is_symlink()):
        return
    head = b""
    if path.is_file():
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    if not (head.startswith(_PNG) and _MARK.encode("ascii") in head):
        raise CaptureError(
            f"{path} is there and is not the picture of a check: give another name to --out, or move it away"
        )
