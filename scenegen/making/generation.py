"""Makes the scenes of a dataset: draw a sample, check it against the geometry, write its files."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from scenegen.dataset import Dataset, DatasetError, build_index, open_dataset, write_index
from scenegen.files.whole_files import is_partial, remove_leftovers, whole_folder
from scenegen.preset import Preset
from scenegen.rendering_record import read_rendering_record, write_rendering_record
from scenegen.sampling import sample_valid_scene
from scenegen.scene import Scene, scene_from_json, scene_id

NO_MESHES: Mapping[str, str] = MappingProxyType({})


class Maker(Protocol):
    """Interface of a class that makes a scene's files: `scenegen.making.blender.BlenderMaker`."""

    @property
    def version(self) -> str:
        """Version of the program that makes the meshes."""

    def refusal(self, scene: Scene) -> str | None:
        """Why the scene is impossible; None for a possible one."""

    def files(self, scene: Scene) -> dict[str, bytes]:
        """Names and contents of the scene's files."""


def check_target(root: Path, preset: Preset, meshes: Mapping[str, str] = NO_MESHES) -> None:
    """Refuse a folder that has anything but scenes of `preset`, in the same number or fewer.

    Parameters
    ----------
    meshes : SHA-256 of the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    DatasetError : the folder has other files, or a dataset of another preset or seed, of more scenes or of
        other meshes.
    """
    foreign = DatasetError(f"{root} has other files and is not a NIGHT dataset: choose an empty folder")
    if root.exists() and not root.is_dir():
        raise foreign
    if (root / "dataset.json").exists():
        count = _check_extends(root, preset, meshes)
        refused = [entry for entry in _surplus(root / "scenes", count) if not _is_ours(entry, preset)]
    elif root.exists() and any(e.name != "scenes" and not is_partial(e.name) for e in root.iterdir()):
        raise foreign
    else:
        surplus = _surplus(root / "scenes", preset.dataset.count)
        refused = [entry for entry in surplus if not _is_scene_folder(entry)]
    if refused:
        raise DatasetError(
            f"{refused[0]} is none of the dataset's scenes: remove it or choose an empty folder"
        )


def generate(
    root: Path,
    preset: Preset,
    maker: Maker,
    on_scene: Callable[[], None],
    *,
    meshes: Mapping[str, str] = NO_MESHES,
) -> Dataset:
    """Make all scenes of `preset` in the folder `root`, in this process.

    The same preset gives the same bytes. Every scene is computed, which takes milliseconds, and its folder is
    written only if it does not have these bytes already. A second run therefore continues an interrupted one,
    repairs damaged scenes, and adds scenes where the preset now asks for more. Each scene's folder appears
    complete or not at all; ``dataset.json`` is written last. Scenes that an interrupted run of more scenes
    has left are removed.

    Parameters
    ----------
    root : folder of the dataset; made if missing.
    maker : makes the files; it knows the preset's meshes.
    on_scene : called after every scene.
    meshes : SHA-256 of the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    DatasetError : as `check_target`.
    SamplingError : the preset's ranges leave an object no room.
    """
    prepare(root, preset, meshes)
    scenes = (write_scene(root, preset, index, maker) for index in range(preset.dataset.count))
    return finish(root, preset, meshes, reported(scenes, on_scene), maker.version)


def prepare(root: Path, preset: Preset, meshes: Mapping[str, str]) -> None:
    """Check the folder; remove the scenes that an interrupted run of more scenes has left."""
    check_target(root, preset, meshes)
    for entry in _surplus(root / "scenes", preset.dataset.count):
        shutil.rmtree(entry)


def finish(
    root: Path, preset: Preset, meshes: Mapping[str, str], scenes: Iterable[Scene], version: str
) -> Dataset:
    """Collect the scenes as they are made, then write the index."""
    index = build_index(preset, scenes, version, meshes=meshes)
    if (root / "dataset.json").exists():
        _keep_rendering(open_dataset(root))
    write_index(root, index)
    return open_dataset(root)


def _keep_rendering(dataset: Dataset) -> None:
    """Give a dataset's rendering record the file of its own that it has had since schema 3."""
    if dataset.index.rendering is not None and read_rendering_record(dataset.renders) is None:
        write_rendering_record(dataset.renders, dataset.index.rendering)


def reported(scenes: Iterable[Scene], on_scene: Callable[[], None]) -> Iterator[Scene]:
    """Yield the scenes; call `on_scene` before each."""
    for scene in scenes:
        on_scene()
        yield scene


def write_scene(root: Path, preset: Preset, index: int, maker: Maker) -> Scene:
    """Draw scene `index` and write its folder, unless it already has exactly these bytes."""
    scene = sample_valid_scene(preset, index, maker.refusal)
    files = maker.files(scene)
    folder = root / "scenes" / scene.id
    if not _holds(folder, files):
        with whole_folder(folder, sweep=False) as partial:  # `prepare` has removed the leftovers
            for name, contents in files.items():
                (partial / name).write_bytes(contents)
    return scene


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Whether a folder has exactly these files with exactly these bytes."""
    try:
        if {entry.name for entry in folder.iterdir()} != set(files):
            return False
        return all((folder / name).read_bytes() == contents for name, contents in files.items())
    except OSError:
        return False


def _check_extends(root: Path, preset: Preset, meshes: Mapping[str, str]) -> int:
    """Number of scenes of the dataset in `root`; `preset` must ask for the same scenes, or for more."""
    index = open_dataset(root).index
    count = index.preset.dataset.count
    if replace(preset, dataset=replace(preset.dataset, count=count)) != index.preset:
        raise DatasetError(
            f"{root} already holds a dataset of another preset or seed: choose an empty folder"
        )
    if preset.dataset.count < count:
        raise DatasetError(
            f"{root} already holds {count} scenes, and {preset.dataset.count} are asked for: "
            f"give --count {count} or more, or choose an empty folder"
        )
    for shape, sha256 in index.meshes.items():
        if meshes.get(shape) != sha256:
            raise DatasetError(
                f"{root} was made with another {shape}: put that file back or choose an empty folder"
            )
    return count


def _surplus(scenes: Path, count: int) -> list[Path]:
    """Entries of the folder of scenes that are none of the first `count` scenes."""
    if not scenes.is_dir():
        return [scenes] if scenes.exists() else []
    remove_leftovers(scenes)
    expected = {scene_id(index) for index in range(count)}
    return sorted(e for e in scenes.iterdir() if e.name not in expected and not is_partial(e.name))


def _is_scene_folder(entry: Path) -> bool:
    return re.fullmatch(r"\d{6}", entry.name) is not None and entry.is_dir() and not entry.is_symlink()


def _is_ours(entry: Path, preset: Preset) -> bool:
    """Whether an interrupted run that added scenes to the dataset of `preset` left this folder."""
    if not _is_scene_folder(entry):
        return False
    try:
        scene = scene_from_json((entry / "scene.json").read_text(encoding="utf-8"), str(entry))
    except (OSError, ValueError):
        return False
    return (scene.dataset_seed, scene.id) == (preset.dataset.seed, entry.name)
