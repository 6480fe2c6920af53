"""The numbers of a grey picture: PNG and TIFF by Pillow, and PGM, of more than 8 bits.

A TIFF file of several pages, and a PGM file of several pictures, have the axis frame. Pillow would stretch
the numbers of a PGM file with another largest number than 65535, so that this format is read here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from itof.arrays import Numbers
from itof.files.array_claims import Claims, RefusedError
from itof.files.npz_reading import BARE

IMAGE_ENDINGS: Final = (".png", ".tif", ".tiff", ".pgm")
_MOST_PAGES = 4096
_PGM: Final = re.compile(rb"P5\s(?:\s|#[^\n]*\n)*(\d{1,5})\s+(\d{1,5})\s+(\d{1,5})\s")
_TYPES: Final = {"L": "u1", "I;16": "u2", "I;16L": "u2", "I;16B": "u2", "I;16N": "u2", "I": "i4", "F": "f4"}


def read_picture(path: Path) -> tuple[dict[str, Numbers], list[str]]:
    """The numbers (row, column) or (frame, row, column) of a picture, under the name `BARE`.

    Raises
    ------
    RefusedError : it is no grey picture, is damaged, or claims more than it can hold.
    """
    values = _pgm(path) if path.suffix.lower() == ".pgm" else _by_pillow(path)
    return {BARE: values}, [BARE]


def _pgm(path: Path) -> Numbers:
    Claims(path).add("the file", np.dtype(np.uint8), (path.stat().st_size,), path.stat().st_size)
    data, at, frames = path.read_bytes(), 0, list[Numbers]()
    while match := _PGM.match(data, at):
        width, height, largest = (int(text) for text in match.groups())
        dtype = np.dtype(">u2" if largest > 255 else "u1")
        at, count = match.end(), width * height
        if not count or not 0 < largest < 2**16 or at + count * dtype.itemsize > len(data):
            break
        frames.append(np.frombuffer(data, dtype, count, at).reshape(height, width))
        at += count * dtype.itemsize
    if at != len(data) or len({frame.shape for frame in frames}) != 1:
        raise RefusedError(f"{path} cannot be read: it is damaged or no binary PGM file (P5)")
    return np.stack(frames) if len(frames) > 1 else frames[0]


def _by_pillow(path: Path) -> Numbers:
    from PIL import Image, UnidentifiedImageError

    claims, size = Claims(path), path.stat().st_size
    try:
        with Image.open(path, formats=("PNG", "TIFF")) as image:
            count = min(getattr(image, "n_frames", 1), _MOST_PAGES + 1)
            if image.mode not in _TYPES or count > _MOST_PAGES:
                raise RefusedError(
                    f"{path} has {count} pages of the kind {image.mode}, and up to {_MOST_PAGES} grey ones "
                    "are read: save one grey channel of 16 bits"
                )
            dtype = np.dtype(_TYPES[image.mode])
            frames = []
            for page in range(count):
                image.seek(page)
                claims.add(f"page {page}", dtype, (image.height, image.width), size)
                frames.append(np.asarray(image))
    except UnidentifiedImageError:
        raise RefusedError(f"{path} cannot be read: it is damaged or no PNG or TIFF file") from None
    return np.stack(frames) if len(frames) > 1 else frames[0]
