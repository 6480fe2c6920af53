"""A folder for temporary files and caches that no other user of the machine can read or change."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path


def private_folder() -> Path:
    """The folder ``night-<user number>`` in the system's folder for temporary files; made if it is missing.

    All processes of a user get the same folder. Only where something else has its name, which another user
    may have put there, it is a new folder in every process.

    Raises
    ------
    OSError : no folder for temporary files can be written to.
    """
    folder = Path(tempfile.gettempdir()) / f"night-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        found = folder.lstat()
        others = found.st_mode & (stat.S_IRWXG | stat.S_IRWXO)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or others:
            return Path(tempfile.mkdtemp(prefix="night-"))  # this has the mode 0700, too
    return folder
