"""The sentence that a command ends with, for errors of the system: what happened, where, and what to do."""

from __future__ import annotations

import os
from errno import EACCES, EDQUOT, EEXIST, EFBIG, EIO, EMFILE, ENFILE, ENOMEM, ENOSPC, ENOTDIR, EPERM, EROFS
from resource import RLIMIT_NOFILE, getrlimit

_PERMISSION = "{place}: Permission denied: change its permissions (chmod), or give another place"
_SYSTEM = {
    ENOSPC: "no space left on the disk of {place}: free some space and start again",
    EDQUOT: "your quota on the disk of {place} is used up: free some space and start again",
    EFBIG: "{place}: File too large: the limit on file sizes (ulimit -f) is too low, or the disk takes no "
    "files of this size",
    EIO: "{place}: Input/output error: the disk or its connection is faulty; see the system's log (dmesg)",
    EROFS: "{place}: Read-only file system: make it writable, or give another place",
    EACCES: _PERMISSION,
    EPERM: _PERMISSION,
    ENOTDIR: "{place}: Not a directory: a part of this path is a file; give another place",
    EEXIST: "{place}: File exists: a file of another kind has this name; move it away, or give another place",
    EMFILE: "{place}: Too many open files: raise the limit of {open_files} (ulimit -n) and start again",
    ENFILE: "{place}: Too many open files on this machine: close other programs and start again",
}
_LESS_MEMORY = {  # by command: what makes it need less
    "scenes": "use fewer --workers",
    "render": "use a smaller --resolution or fewer --workers",
    "verify": "use fewer --workers",
    "night-train": "use a smaller --batch-size or --width",
}
_LONGEST_WORD, _LONGEST = 1000, 2000  # characters
_MORE_MEMORY = "close other programs, or use a machine with more memory"


def sentence_of(error: BaseException, command: str, place: str) -> str:
    """One line of text about an error; text of a file in it is shortened, and has no control characters.

    Parameters
    ----------
    command : name of the command that it ends.
    place : where the command writes; for errors of the system that do not say which file they are about.
    """
    text = printable(_words(error, command, place))
    return _shortened(" ".join(_shortened(word, _LONGEST_WORD) for word in text.split(" ")), _LONGEST)


def printable(line: str) -> str:
    """A line without control characters, which text of a file may hold, and which a terminal would obey."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def _shortened(text: str, most: int) -> str:
    """At most about `most` characters of a text: its beginning and its end."""
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-most // 2 :]}"


def _words(error: BaseException, command: str, place: str) -> str:
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == ENOMEM):
        what = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        words = f"out of memory ({what})" if what else "out of memory"
        return f"{words}: {_LESS_MEMORY.get(command, _MORE_MEMORY)}"
    if isinstance(error, OSError) and error.errno is not None and error.strerror:
        named = isinstance(error.filename, (str, bytes))  # not the number of an open file
        where = os.fsdecode(error.filename) if named else place
        words = _SYSTEM.get(error.errno, "{place}: {problem}" if where else "{problem}")
        return words.format(
            place=where or "a temporary file", problem=error.strerror, open_files=getrlimit(RLIMIT_NOFILE)[0]
        )
    return " ".join(str(error).split()) or type(error).__name__
