"""Reading files of strangers: no pipe is waited for, no device is read for ever, and none is too large.

Text is UTF-8, with or without a byte order mark.
"""

from __future__ import annotations

import codecs
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EFBIG, EINVAL
from pathlib import Path
from typing import BinaryIO, Final

MOST_BYTES: Final = 2**24  # of settings, and of a record of one scene or command
MOST_LIST_BYTES: Final = 2**29  # of a file that lists scenes or files: a million scenes take 300 MB
_MARKS: Final = (  # the longest first: that of UTF-32 begins like that of UTF-16
    (codecs.BOM_UTF32_LE, "UTF-32"),
    (codecs.BOM_UTF32_BE, "UTF-32"),
    (codecs.BOM_UTF16_LE, "UTF-16"),
    (codecs.BOM_UTF16_BE, "UTF-16"),
)


def read_plain(file: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """The bytes of a file.

    Raises
    ------
    OSError : it cannot be read, is no plain file, or has more than `most_bytes`.
    """
    with opened_plain(file) as (stream, size):
        if size > most_bytes:
            raise OSError(EFBIG, f"it has {size} bytes, more than {most_bytes}", str(file))
        return stream.read(most_bytes)


def read_text(file: Path, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file.

    Raises
    ------
    OSError : as `read_plain`.
    UnicodeError : as `decoded`.
    """
    return decoded(read_plain(file, most_bytes))


def decoded(content: bytes) -> str:
    """The text in the bytes of a file; `UnicodeError` names the encoding if it is not UTF-8."""
    try:
        text = content.decode("utf-8-sig")
        if "\0" not in text[:4]:
            return text
    except UnicodeDecodeError:
        pass
    raise UnicodeError(f"it is {_encoding(content)}: save it as UTF-8 text")


def _encoding(content: bytes) -> str:
    """What text that is not UTF-8 seems to be: mark, then zeros among the first letters, then bytes."""
    for mark, name in _MARKS:
        if content.startswith(mark):
            return name
    zeros = content[:4].count(0)
    if zeros:
        return {3: "UTF-32", 2: "UTF-16"}.get(zeros, "no text")
    return "not UTF-8, but perhaps Windows-1252 or Latin-1"


@contextmanager
def opened_plain(file: Path) -> Iterator[tuple[BinaryIO, int]]:
    """Open a file to read it; yields the stream and the size of the file, bytes.

    Raises
    ------
    OSError : it cannot be opened, or is no plain file.
    """
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(EINVAL, "it is no plain file", str(file))
        yield stream, found.st_size
