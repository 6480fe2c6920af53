"""The folder ``scenes/<id>/``: names of its files, their contents, and the digest of all of them.

``dataset.json`` holds the digest of every scene folder, of the bytes that ``night-gen`` made. A folder with
another digest was damaged or edited.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import get_args

from disk.contract import ContractError
from disk.night_error import NightError
from scenegen.mitsuba_description import (
    EMITTER_IMAGE,
    hidden_names,
    is_emitter_pfm,
    mirrored_names,
    wall_names,
)
from scenegen.mitsuba_xml import MIRRORED_XML, SEEN_XML, scene_files_for_mitsuba
from scenegen.scene import RoomWallName, Scene, scene_from_json, scene_to_json
from scenegen.wall_image import WALL_IMAGE, wall_pfm

SCENE_FILE = "scene.json"
WALLS = ("relay_wall", "middle_wall")
_FIXED_NAMES = {SCENE_FILE, SEEN_XML, MIRRORED_XML, EMITTER_IMAGE, *(f"{wall}.ply" for wall in WALLS)}
_ANY_NAMES = _FIXED_NAMES | {WALL_IMAGE}
_OTHER_MESH = re.compile(
    rf"((mirrored_)?hidden_object_[0-9]+|mirrored_middle_wall|{'|'.join(get_args(RoomWallName))})\.ply"
)
MOST_FILE_BYTES = 2**30  # of a folder: two million triangles, the most that a mesh may have, take 50 MB


class SceneFolderError(NightError):
    """A scene folder that is missing, or holds anything but regular files."""


def is_scene_file(name: str) -> bool:
    """Whether night-gen writes files of this name into scene folders."""
    return name in _ANY_NAMES or _OTHER_MESH.fullmatch(name) is not None


def digest_of(files: Mapping[str, bytes]) -> str:
    """SHA-256 of the names and contents of the files of a scene folder."""
    return _digest(sorted(files.items()))


def folder_digest(folder: Path) -> str:
    """`digest_of` the files in a folder, one file in memory at a time.

    Raises
    ------
    SceneFolderError : as `read_scene_folder`.
    """
    return _digest(_contents(folder))


def read_scene_folder(folder: Path) -> dict[str, bytes]:
    """Contents of all files in a scene folder, by name.

    Raises
    ------
    SceneFolderError : the folder is missing or empty, has more than 1 GiB, or has a symbolic link, a folder
        or anything else that is not a regular file; the message names it.
    """
    return dict(_contents(folder))


def scene_of(files: Mapping[str, bytes], folder: Path) -> Scene:
    """The scene that the files of a folder describe.

    Raises
    ------
    ContractError : ``scene.json`` is missing or damaged, or describes the scene of another folder.
    """
    file = folder / SCENE_FILE
    if SCENE_FILE not in files:
        raise ContractError(f"{file} is missing: run night-gen scenes again")
    scene = scene_from_json(files[SCENE_FILE], str(file))
    if scene.id != folder.name:
        raise ContractError(f"{file} describes scene {scene.id}: run night-gen scenes again")
    return scene


def differences(folder: Path) -> str:
    """What is wrong in a scene folder that has not the digest it should have, as far as its files tell."""
    try:
        files = read_scene_folder(folder)
        scene = scene_of(files, folder)
    except NightError as error:
        return str(error)
    meshes = {f"{name}.ply" for name in (*wall_names(scene), *hidden_names(scene), *mirrored_names(scene))}
    image = wall_pfm(scene.relay_wall)
    expected = (_FIXED_NAMES if image is None else _ANY_NAMES) | meshes
    for name in sorted(files.keys() ^ expected):
        return f"{folder / name} is {'missing' if name in expected else 'not one of its files'}"
    if files[SCENE_FILE] != scene_to_json(scene).encode():
        return f"{folder / SCENE_FILE} was changed"
    if not is_emitter_pfm(files[EMITTER_IMAGE], scene):
        return f"{folder / EMITTER_IMAGE} was changed"
    if image is not None and files[WALL_IMAGE] != image:
        return f"{folder / WALL_IMAGE} was changed"
    for name in ineffective(files, scene):
        return f"{folder / name} or {SCENE_FILE} was changed"
    return f"{SCENE_FILE} or a mesh in {folder} was changed"


def ineffective(files: Mapping[str, bytes], scene: Scene) -> list[str]:
    """Names of the Mitsuba scene files that differ from `scene`; they have no effect on a rendering."""
    exported = scene_files_for_mitsuba(scene)
    return [name for name, text in exported.items() if files.get(name, b"") != text.encode()]


def _digest(files: Iterable[tuple[str, bytes]]) -> str:
    digest = hashlib.sha256()
    for name, contents in files:
        digest.update(os.fsencode(name) + b"\0" + contents)
    return digest.hexdigest()


def _contents(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Name and contents of each file, sorted by name."""
    try:
        with os.scandir(folder) as entries:
            found = sorted(entries, key=lambda entry: entry.name)
    except (FileNotFoundError, NotADirectoryError):
        found = []
    if not found:
        raise SceneFolderError(f"{folder} is missing or empty: run night-gen scenes again")
    total = 0
    for entry in found:
        if not entry.is_file(follow_symlinks=False):
            raise SceneFolderError(
                f"{entry.path} is {'a symbolic link' if entry.is_symlink() else 'no regular file'}, and a "
                "scene folder holds regular files alone: move it elsewhere and run night-gen scenes again"
            )
        total += entry.stat(follow_symlinks=False).st_size
        if total > MOST_FILE_BYTES:
            raise SceneFolderError(
                f"{folder} is larger than a scene can be (up to {entry.name}): run night-gen scenes again"
            )
        yield entry.name, Path(entry.path).read_bytes()
