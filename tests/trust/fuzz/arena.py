"""The folders around a command that reads a damaged file: its own, and what lies beside it."""

import os
import shutil
from fnmatch import fnmatchcase
from pathlib import Path

PRIVATE = "private"  # of the child itself: what it prints, and TMPDIR
LIBRARIES = ("home/.config", "home/.cache", "home/.drjit")  # caches and settings of Dask, Blender and DrJit


class Arena:
    """A copy of the samples in ``work``, and beside it ``victim`` and ``home``, which no command may change.

    Files in ``victim`` have never been read, says their time of access (0), where the disk keeps such times.

    Parameters
    ----------
    folder : a new folder.
    template : what ``work`` and ``victim`` hold before each command.
    private : another disk's folder for what the commands print; None for one in `folder`.
    """

    def __init__(self, folder: Path, template: Path, private: Path | None = None) -> None:
        self.folder, self.template = folder, template
        shutil.copytree(template, folder, symlinks=True)
        (folder / "home").mkdir()
        if private is None:
            (folder / PRIVATE).mkdir()
        else:
            (folder / PRIVATE).symlink_to(private)
        self._before = self._unread_state()

    @property
    def work(self) -> Path:
        """Working directory of the commands."""
        return self.folder / "work"

    def put(self, name: str, data: bytes) -> None:
        """Replace a file of ``work``; it counts as unchanged until the next `restore`."""
        file = self.work / name
        file.write_bytes(data)
        self._before[f"work/{name}"] = _stamp(file.lstat())

    def changed(self) -> set[str]:
        """Paths that were changed, or read in ``victim``, since the last `restore` and `put`."""
        now = self._state()
        return {path for path in now.keys() | self._before.keys() if now.get(path) != self._before.get(path)}

    def restore(self, changed: set[str], put: set[str]) -> None:
        """Bring these paths, and the files of `put`, back to what the template has."""
        for path in sorted({*changed, *(f"work/{name}" for name in put)}, reverse=True):
            _remove(self.folder / path)
        for path in sorted({*changed, *(f"work/{name}" for name in put)}):
            _copy(self.template / path, self.folder / path)
        for entry in (self.folder / PRIVATE).iterdir():
            _remove(entry)
        self._before = self._unread_state()

    def state(self, name: str) -> dict[str, tuple[int, ...]]:
        """Kind, size and time of everything in a folder beside ``work``."""
        return dict(_walk(self.folder / name, ""))

    def _unread_state(self) -> dict[str, tuple[int, ...]]:
        for file in (self.folder / "victim").rglob("*"):
            if file.is_file():
                os.utime(file, ns=(0, file.stat().st_mtime_ns))
        return self._state()

    def _state(self) -> dict[str, tuple[int, ...]]:
        return dict(_walk(self.folder, ""))


def allowed(path: str, patterns: tuple[str, ...]) -> bool:
    """Whether a changed path, or a folder that it lies in, is one that the command may write."""
    names = path.split("/")
    return any(
        fnmatchcase("/".join(names[:count]), f"work/{pattern}")
        for count in range(1, len(names) + 1)
        for pattern in patterns
    )


def contents(folder: Path, patterns: tuple[str, ...]) -> dict[str, bytes]:
    """Bytes of all files below the paths that the patterns name."""
    roots = [path for pattern in patterns for path in folder.glob(pattern)]
    files = [
        file
        for root in roots
        for file in ([root] if root.is_file() else sorted(root.rglob("*")))
        if file.is_file() and not file.is_symlink()
    ]
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def _walk(folder, prefix):
    with os.scandir(folder) as entries:
        for entry in entries:
            path = prefix + entry.name
            if path in (PRIVATE, *LIBRARIES):
                continue
            if entry.is_dir(follow_symlinks=False):
                yield path, (entry.stat(follow_symlinks=False).st_mode,)
                yield from _walk(entry.path, f"{path}/")
            else:
                yield path, _stamp(entry.stat(follow_symlinks=False))


def _stamp(state):
    return (state.st_mode, state.st_size, state.st_mtime_ns, state.st_ino, state.st_atime_ns == 0)


def _remove(path):
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _copy(source, target):
    if source.is_dir():
        target.mkdir(parents=True, exist_ok=True)
    elif source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target)
