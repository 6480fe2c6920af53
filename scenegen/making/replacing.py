"""A dataset that is made again with another preset: what is lost by that, and its removal."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from disk.byte_size import size
from disk.inner_paths import inside
from scenegen.dataset import open_dataset
from scenegen.making.target import NO_MESHES
from scenegen.preset import Preset

_NAMED = 4  # keys that are named


def losses(root: Path, preset: Preset, meshes: Mapping[str, str] = NO_MESHES) -> str | None:
    """What is lost if the dataset in `root` is replaced by one of `preset`; None if nothing is.

    Parameters
    ----------
    meshes : SHA-256 of the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    DatasetError : `root` has a dataset that cannot be read.
    """
    if not (root / "dataset.json").exists():
        return None
    dataset = open_dataset(root)
    before, count = dataset.preset, dataset.preset.dataset.count
    same = replace(preset, dataset=replace(preset.dataset, count=count)) == before
    known = all(meshes.get(shape) == sha256 for shape, sha256 in dataset.index.meshes.items())
    if same and known and preset.dataset.count >= count:
        return None
    rendered = sum(dataset.render_folder(scene).is_dir() for scene in dataset.ids())
    folders = [inside(root, name) for name in ("scenes", "renders", "shards")]
    held = sum(file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file())
    changes = list(_changes(asdict(before), asdict(preset))) or ["another mesh"]
    more = f" and {len(changes) - _NAMED} more" if len(changes) > _NAMED else ""
    return (
        f"{count} scenes and {rendered} renders in {root}, {size(held)}, to make them again with "
        f"{', '.join(changes[:_NAMED])}{more}"
    )


def remove_renders(root: Path) -> None:
    """Remove the renders and the arrays for training; scenes are replaced when they are made."""
    for name in ("renders", "shards"):
        folder = inside(root, name)
        if folder.is_dir():
            shutil.rmtree(folder)


def _changes(before: Any, after: Any, key: str = "") -> Iterator[str]:
    """Each key of plain data that changes, with its new value."""
    if isinstance(before, dict) and isinstance(after, dict):
        for name in after:
            yield from _changes(before.get(name), after[name], f"{key}.{name}" if key else name)
    elif before != after:
        text = f"{after:.10g}" if isinstance(after, float) else str(after)
        yield f"{key} = {text}"
