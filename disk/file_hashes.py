"""SHA-256 of many files, cached by size and time of change, as in git's index.

Hashing a dataset of transients takes hours; reading the sizes and times of its files takes seconds. The cache
may be deleted at any time, which only costs time. ``night-render verify`` does not use it.
"""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

from disk.path_like import PathLike
from disk.plain_file import MOST_LIST_BYTES, read_plain
from disk.whole_writing import write_text

HASHES_FILE = ".hashes.json"
_RACY_NS = 2_000_000_000  # a file that is younger may change again without a new time of change


def sha256_of(file: PathLike) -> str:
    """SHA-256 of a file's bytes as hexadecimal text; `OSError` when the file cannot be read."""
    with Path(file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class FileHashes:
    """Hashes of the files under `root`, cached in ``root/.hashes.json``.

    Several threads may share one object. Several processes may use one folder: the last `save` replaces the
    others, which only costs time.
    """

    def __init__(self, root: PathLike) -> None:
        self.root = Path(root)
        self._known = _read(self.root / HASHES_FILE)
        self._changed = False

    def sha256(self, file: PathLike) -> str:
        """SHA-256 of a file under `root`; it is read only if it has changed. `OSError` when that fails."""
        file = Path(file)
        state = file.stat()
        name = file.relative_to(self.root).as_posix()
        stamp = [state.st_size, state.st_mtime_ns, state.st_ino]
        known = self._known.get(name)
        if known is not None and known[:3] == stamp:
            return str(known[3])
        digest = sha256_of(file)
        if time.time_ns() - state.st_mtime_ns > _RACY_NS:
            self._known[name] = [*stamp, digest]
            self._changed = True
        return digest

    def learn(self, file: PathLike, sha256: str) -> None:
        """Store the hash of a file that was written and hashed just now."""
        file = Path(file)
        try:
            state = file.stat()
        except OSError:
            return
        name = file.relative_to(self.root).as_posix()
        self._known[name] = [state.st_size, state.st_mtime_ns, state.st_ino, sha256]
        self._changed = True

    def save(self) -> None:
        """Write the cache if it has changed; a folder without write permission is not an error."""
        if not self._changed or not self.root.is_dir():  # a dataset that was deleted stays deleted
            return
        try:
            write_text(self.root / HASHES_FILE, json.dumps(self._known) + "\n")
        except OSError:
            return
        self._changed = False


def _read(file: Path) -> dict[str, list[int | str]]:
    try:
        known = json.loads(read_plain(file, MOST_LIST_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(known, dict):
        return {}
    return {name: entry for name, entry in known.items() if isinstance(entry, list) and len(entry) == 4}
