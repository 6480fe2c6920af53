"""A dataset that is made again with another preset: what is lost by that, and its removal."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from disk.byte_size import size
from disk.counted import counted
from disk.inner_paths import inside
from disk.partials import is_partial
from scenegen.dataset import open_dataset
from scenegen.making.target import NO_MESHES, refuse_files_of_others
from scenegen.preset import Preset

_NAMED = 4  # keys that are named
_REMOVED = ("renders", "shards")
_MADE = re.compile(  # by night-render and night-train: docs/reference/files.md
    r"renders/(rendering\.json|night-render\.log|\.run|\.note|\.hashes\.json|\.claims/\d{6}|\d{6}/("
    r"(mirrored_)?transient\.exr|(itof|mirrored)\.exr|(render|failure|bad)\.json|failure\.log))"
    r"|shards/([a-z]+/)?(manifest\.json|reference\.npy|\d{6}/(piece\.json|[a-z_]+\.npy))"
)


def losses(root: Path, preset: Preset, meshes: Mapping[str, str] = NO_MESHES) -> str | None:
    """What is lost if the dataset in `root` is replaced by one of `preset`; None if nothing is.

    Parameters
    ----------
    meshes : SHA-256 of the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    DatasetError : `root` has a dataset that cannot be read, or files of others among its renders.
    """
    if not (root / "dataset.json").exists():
        return None
    dataset = open_dataset(root)
    before, count = dataset.preset, dataset.preset.dataset.count
    known = all(meshes.get(shape) == sha256 for shape, sha256 in dataset.index.meshes.items())
    if preset.continues(before) and known and preset.dataset.count >= count:
        return None
    refuse_files_of_others(_others(root))
    rendered = sum(dataset.render_folder(scene).is_dir() for scene in dataset.ids())
    folders = [inside(root, name) for name in ("scenes", *_REMOVED)]
    held = sum(file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file())
    changes = list(_changes(asdict(before), asdict(preset))) or ["another mesh"]
    more = f" and {len(changes) - _NAMED} more" if len(changes) > _NAMED else ""
    lost = f"{counted(count, 'scene')} and {counted(rendered, 'render')} in {root}, {size(held)}"
    return f"{lost}, to make them again with {', '.join(changes[:_NAMED])}{more}"


def remove_renders(root: Path) -> None:
    """Remove the renders and the arrays for training; scenes are replaced when they are made."""
    for name in _REMOVED:
        folder = inside(root, name)
        if folder.is_dir():
            shutil.rmtree(folder)


def _others(root: Path) -> Iterator[Path]:
    """Files and links among the renders and the arrays for training that NIGHT did not make."""
    for file in (file for name in _REMOVED for file in inside(root, name).rglob("*")):
        name = file.relative_to(root).as_posix()
        is_made = _MADE.fullmatch(name) is not None or any(map(is_partial, name.split("/")))
        if file.is_symlink() or not (file.is_dir() or is_made):
            yield file


def _changes(before: Any, after: Any, key: str = "") -> Iterator[str]:
    """Each key of plain data that changes, with its new value."""
    if isinstance(before, dict) and isinstance(after, dict):
        for name in after:
            yield from _changes(before.get(name), after[name], f"{key}.{name}" if key else name)
    elif before != after:
        text = f"{after:.10g}" if isinstance(after, float) else str(after)
        yield f"{key} = {text}"
