"""A file's own SHA-256 inside the file.

The digest is that of the whole file with 64 zeros in place of its own 64 digits. It covers every byte, and it
is compared before anything in the file is interpreted. It finds damage, not forgery: whoever writes a file
can write its digest too.
"""

from __future__ import annotations

import hashlib
from typing import Final, NamedTuple

DIGITS: Final = 64
ZEROS: Final = "0" * DIGITS
_BEFORE_RUN, _BEFORE_DIGEST = "NIGHT run ", " sha256 "


class Label(NamedTuple):
    """What a file says about itself: the id of its run, and whether its checksum is right."""

    run_id: str
    is_right: bool


def with_checksum(content: bytes, mark: str) -> bytearray:
    """`content` with its digest in place of the 64 zeros after the last `mark`."""
    place, whole = _place(content, mark), bytearray(content)
    whole[place : place + DIGITS] = _digest(content, place).encode()
    return whole


def has_right_checksum(content: bytes, mark: str) -> bool:
    """Whether the 64 digits after the last `mark` are the digest of `content`."""
    place = _place(content, mark)
    return place >= 0 and content[place : place + DIGITS] == _digest(content, place).encode()


def label_text(run_id: str) -> str:
    """The label of a binary file of a run, with zeros as digest."""
    return f"{_BEFORE_RUN}{run_id}{_BEFORE_DIGEST}{ZEROS}"


def labelled(content: bytes) -> bytearray:
    """`content`, which contains a `label_text`, with its digest."""
    return with_checksum(content, _BEFORE_DIGEST)


def read_label(content: bytes) -> Label | None:
    """The label in `content`; None if there is none."""
    end = _place(content, _BEFORE_DIGEST) - len(_BEFORE_DIGEST)
    start = end - DIGITS
    if start < len(_BEFORE_RUN) or content[start - len(_BEFORE_RUN) : start] != _BEFORE_RUN.encode():
        return None
    run_id = content[start:end].decode("ascii", errors="replace")
    return Label(run_id, has_right_checksum(content, _BEFORE_DIGEST))


def _place(content: bytes, mark: str) -> int:
    """Index of the first digit after the last `mark`; negative if there is no room for a digest."""
    found = content.rfind(mark.encode())
    place = found + len(mark)
    return place if found >= 0 and place + DIGITS <= len(content) else -1


def _digest(content: bytes, place: int) -> str:
    view = memoryview(content)
    digest = hashlib.sha256(view[:place])
    digest.update(ZEROS.encode())
    digest.update(view[place + DIGITS :])
    return digest.hexdigest()
