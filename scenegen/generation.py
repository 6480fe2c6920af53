"""Making a dataset's scenes: draw, check in the maker's geometry, write, skip what is already there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from scenegen.dataset import Dataset, DatasetError, build_index, open_dataset, write_index
from scenegen.preset import Preset, PresetError
from scenegen.sampling import sample_scene, sample_valid_scene
from scenegen.scene import Scene, scene_from_json, scene_id
from scenegen.whole_files import whole_folder


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
    if (root / "dataset.json").exists():
        if open_dataset(root).preset != preset:
            raise DatasetError(
                f"{root} already holds a dataset of another preset, count or seed: choose an empty folder"
            )
    elif root.exists() and (not root.is_dir() or {entry.name for entry in root.iterdir()} - {"scenes"}):
        raise DatasetError(f"{root} holds other files and is no NIGHT dataset: choose an empty folder")


def generate(root: Path, preset: Preset, maker: Maker, on_scene: Callable[[], None]) -> Dataset:
    """Make all scenes of `preset` in `root`; scenes that are already there and the same are kept.

    Every scene's folder appears whole or not at all and ``dataset.json`` comes last, so an interrupted
    run goes on where it was. Same preset, same bytes.

    Raises
    ------
    DatasetError : the folder holds something else.
    SamplingError : the preset's ranges leave an object no room.
    """
    check_target(root, preset)
    scenes = []
    for index in range(preset.dataset.count):
        scene = _existing(root / "scenes" / scene_id(index), preset, index)
        if scene is None:
            scene = sample_valid_scene(preset, index, maker.refusal)
            with whole_folder(root / "scenes" / scene.id) as folder:
                maker.write(scene, folder)
        scenes.append(scene)
        on_scene()
    write_index(root, build_index(preset, scenes, maker.version))
    return open_dataset(root)


def _existing(folder: Path, preset: Preset, index: int) -> Scene | None:
    """The scene in `folder` if it is the one that `preset` would make, else None."""
    file = folder / "scene.json"
    try:
        scene = scene_from_json(file.read_text(encoding="utf-8"), str(file))
    except (OSError, UnicodeDecodeError, PresetError):
        return None
    return scene if scene == sample_scene(preset, index, scene.attempt) else None
