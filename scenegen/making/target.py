"""Checks of the folder that night-gen writes into, before anything in it is changed."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from errno import EBADF
from pathlib import Path
from types import MappingProxyType

from disk.counted import counted
from disk.inner_paths import inside
from disk.locks import lock
from disk.partials import is_partial, remove_leftovers
from disk.plain_file import read_plain
from scenegen.dataset import DatasetError, open_dataset
from scenegen.preset import Preset
from scenegen.scene import scene_from_json, scene_id
from scenegen.scene_folder import SCENE_FILE, is_scene_file

NO_MESHES: Mapping[str, str] = MappingProxyType({})
_NAMED = 3  # files that a refusal names


@contextmanager
def alone_in(root: Path) -> Iterator[None]:
    """Be the only process that makes scenes in the folder `root`, which is made if it is missing.

    Two processes would remove each other's scenes as those of an interrupted run. The lock is that of the
    folder itself, so it leaves no file. NFS locks only what is open for writing, and no folders: there,
    nobody is refused. Folders that were made here and are still empty at the end are removed.

    Raises
    ------
    DatasetError : another process makes scenes in it.
    """
    if os.path.lexists(root) and not root.is_dir():
        yield  # `check_target` refuses it
        return
    new = [folder for folder in (root, *root.parents) if not folder.exists()]
    root.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not _locked(descriptor):
            raise DatasetError(f"another night-gen is making scenes in {root}: wait until it has ended")
        try:
            yield
        finally:
            with suppress(OSError):  # of a folder with anything in it
                for folder in new:
                    folder.rmdir()
    finally:
        os.close(descriptor)


def _locked(folder: int) -> bool:
    """Lock an open folder; False if another process has the lock."""
    try:
        return lock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno != EBADF:  # NFS
            raise
        return True


def check_target(
    root: Path, preset: Preset, meshes: Mapping[str, str] = NO_MESHES, *, replacing: bool = False
) -> None:
    """Refuse a folder that has anything but scenes of `preset`, in the same number or fewer.

    Parameters
    ----------
    meshes : SHA-256 of the mesh files that the preset's shapes name, by shape.
    replacing : whether the dataset may be of another preset, whose scenes are replaced.

    Raises
    ------
    DatasetError : the folder has other files, also inside a scene's folder, or a dataset of another preset or
        seed, of more scenes or of other meshes.
    OutsideError : its folder of scenes is a symbolic link that leads out of it.
    """
    foreign = DatasetError(f"{root} has other files and is not a NIGHT dataset: choose an empty folder")
    if root.exists() and not root.is_dir():
        raise foreign
    if (root / "dataset.json").exists():
        count = _check_extends(root, preset, meshes, replacing=replacing)
        refused = [entry for entry in surplus(root, count) if not _is_ours(entry, preset)]
    elif root.exists() and any(e.name != "scenes" and not is_partial(e.name) for e in root.iterdir()):
        raise foreign
    else:
        refused = [entry for entry in surplus(root, preset.dataset.count) if not _is_scene_folder(entry)]
    if refused:
        raise DatasetError(
            f"{refused[0]} is none of the dataset's scenes: remove it or choose an empty folder"
        )
    refuse_files_of_others(found for entry in _entries(root) for found in _files_of_others(entry))


def surplus(root: Path, count: int) -> list[Path]:
    """Entries of the folder of scenes that are none of the first `count` scenes."""
    expected = {scene_id(index) for index in range(count)}
    return [entry for entry in _entries(root) if entry.name not in expected]


def refuse_files_of_others(files: Iterator[Path]) -> None:
    """`DatasetError` with the names of the first `files`, if there are any.

    Folders of scenes and renders are replaced as a whole. What somebody else put there would be lost.
    """
    found = sorted(files)
    if found:
        names = ", ".join(str(file) for file in found[:_NAMED])
        more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
        raise DatasetError(
            f"NIGHT did not make {names}{more}, which would be deleted with the folder: move them elsewhere"
        )


def _entries(root: Path) -> list[Path]:
    """Entries of the folder of scenes, without the temporary ones, which are removed where possible."""
    scenes = inside(root, "scenes")
    if not scenes.is_dir():
        return [scenes] if os.path.lexists(scenes) else []
    remove_leftovers(scenes)
    return sorted(entry for entry in scenes.iterdir() if not is_partial(entry.name))


def _files_of_others(entry: Path) -> Iterator[Path]:
    """What night-gen did not make at the place of a scene's folder: files, links and folders."""
    if entry.is_symlink() or not entry.is_dir():
        yield entry
        return
    with os.scandir(entry) as files:
        for file in files:
            if not (is_scene_file(file.name) and file.is_file(follow_symlinks=False)):
                yield Path(file.path)


def _check_extends(root: Path, preset: Preset, meshes: Mapping[str, str], *, replacing: bool) -> int:
    """Number of scenes of the dataset in `root`; `preset` must ask for the same scenes, or for more."""
    dataset = open_dataset(root)
    if dataset.is_measured:
        raise DatasetError(
            f"{root} holds captures of a camera, and night-gen would replace their scenes: choose an empty "
            "folder; night-eval capture pairs makes the dataset again"
        )
    index = dataset.index
    count = index.preset.dataset.count
    if replacing:
        return max(count, preset.dataset.count)
    if not preset.continues(index.preset):
        other = "preset, seed or number of frames" if preset.is_sequence else "preset or seed"
        raise DatasetError(
            f"{root} already holds a dataset of another {other}: choose an empty folder, or replace it with "
            "--replace (replace=True)"
        )
    if preset.dataset.count < count:
        raise DatasetError(
            f"{root} already holds {counted(count, 'scene')}, and {preset.dataset.count} is less: give "
            f"--count {count} or more, or choose an empty folder"
        )
    for shape, sha256 in index.meshes.items():
        if meshes.get(shape) != sha256:
            raise DatasetError(
                f"{root} was made with another {shape}: put that file back or choose an empty folder"
            )
    return count


def _is_scene_folder(entry: Path) -> bool:
    return re.fullmatch(r"[0-9]{6}", entry.name) is not None and entry.is_dir() and not entry.is_symlink()


def _is_ours(entry: Path, preset: Preset) -> bool:
    """Whether an interrupted run that added scenes to the dataset of `preset` left this folder."""
    if not _is_scene_folder(entry):
        return False
    try:
        content = read_plain(entry / SCENE_FILE)
        scene = scene_from_json(content, str(entry))
    except (OSError, ValueError):
        return False
    return (scene.dataset_seed, scene.id) == (preset.dataset.seed, entry.name)
