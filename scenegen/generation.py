"""Making a dataset's scenes: draw, check in the maker's geometry, write."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from scenegen.dataset import Dataset, DatasetError, build_index, open_dataset, write_index
from scenegen.preset import Preset
from scenegen.sampling import sample_valid_scene
from scenegen.scene import Scene, scene_id
from scenegen.whole_files import is_partial, remove_leftovers, whole_folder


class Maker(Protocol):
    """What turns a scene into files; `scenegen.blender.BlenderMaker` is the one there is."""

    @property
    def version(self) -> str:
        """Version of the program that makes the meshes."""

    def refusal(self, scene: Scene) -> str | None:
        """Why the scene cannot be, or None."""

    def write(self, scene: Scene, folder: Path) -> None:
        """Write the scene's files into an empty folder."""


def check_target(root: Path, preset: Preset) -> None:
    """Refuse a folder that holds something else.

    Raises
    ------
    DatasetError : the folder has other files, or a dataset of another preset or seed.
    """
    foreign = DatasetError(f"{root} holds other files and is no NIGHT dataset: choose an empty folder")
    if root.exists() and not root.is_dir():
        raise foreign
    finished = (root / "dataset.json").exists()
    if finished:
        if open_dataset(root).preset != preset:
            raise DatasetError(
                f"{root} already holds a dataset of another preset, count or seed: choose an empty folder"
            )
    elif root.exists() and any(e.name != "scenes" and not is_partial(e.name) for e in root.iterdir()):
        raise foreign
    for entry in _surplus(root / "scenes", preset.dataset.count):
        if finished or not _is_scene_folder(entry):
            raise DatasetError(
                f"{entry} is none of the dataset's scenes: remove it or choose an empty folder"
            )


def generate(root: Path, preset: Preset, maker: Maker, on_scene: Callable[[], None]) -> Dataset:
    """Make all scenes of `preset` in `root`; what is there of them is made again.

    Every scene's folder appears whole or not at all and ``dataset.json`` comes last. Same preset, same
    bytes: making again what an interrupted run left costs milliseconds a scene and also mends it. Scenes
    that an interrupted run of more scenes left are removed.

    Raises
    ------
    DatasetError : the folder holds something else.
    SamplingError : the preset's ranges leave an object no room.
    """
    check_target(root, preset)
    for entry in _surplus(root / "scenes", preset.dataset.count):
        shutil.rmtree(entry)
    scenes = []
    for index in range(preset.dataset.count):
        scene = sample_valid_scene(preset, index, maker.refusal)
        with whole_folder(root / "scenes" / scene.id) as folder:
            maker.write(scene, folder)
        scenes.append(scene)
        on_scene()
    write_index(root, build_index(preset, scenes, maker.version))
    return open_dataset(root)


def _surplus(scenes: Path, count: int) -> list[Path]:
    """What lies in the folder of scenes and is none of the first `count`."""
    if not scenes.is_dir():
        return [scenes] if scenes.exists() else []
    remove_leftovers(scenes)
    expected = {scene_id(index) for index in range(count)}
    return sorted(e for e in scenes.iterdir() if e.name not in expected and not is_partial(e.name))


def _is_scene_folder(entry: Path) -> bool:
    return re.fullmatch(r"\d{6}", entry.name) is not None and entry.is_dir() and not entry.is_symlink()
