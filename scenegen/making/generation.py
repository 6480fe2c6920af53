"""Makes the scenes of a dataset: draw a sample, check it against the geometry, write its files."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

from disk.inner_paths import inside
from disk.plain_file import read_plain
from disk.whole_writing import whole_folder
from scenegen.dataset import Dataset, SceneEntry, build_index, open_dataset, scene_entry, write_index
from scenegen.geometry_check import refusal
from scenegen.making.replacing import losses, remove_renders
from scenegen.making.target import NO_MESHES, alone_in, check_target, refuse_files_of_others, surplus
from scenegen.possible_scenes import possible_scenes
from scenegen.preset import Preset
from scenegen.scene import Scene
from scenegen.scene_folder import MOST_FILE_BYTES
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh


class Maker(Protocol):
    """Interface of a class that makes a scene's files: `scenegen.making.blender.BlenderMaker`."""

    @property
    def version(self) -> str:
        """Version of the program that makes the meshes."""

    @property
    def meshes(self) -> Mapping[Shape, UnitMesh]:
        """The mesh files that the scenes' shapes name, by shape."""

    def files(self, scene: Scene) -> dict[str, bytes]:
        """Names and contents of the scene's files."""


def generate(
    root: Path,
    preset: Preset,
    maker: Maker,
    on_scene: Callable[[], None],
    *,
    meshes: Mapping[str, str] = NO_MESHES,
    replacing: bool = False,
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
    replacing : whether a dataset of another preset in the folder is replaced; its renders are removed.

    Raises
    ------
    DatasetError : as `check_target` and `alone_in`.
    SamplingError : the preset's ranges leave an object no room.
    """
    drawn = possible_scenes(preset, functools.partial(refusal, meshes=maker.meshes))
    with alone_in(root):
        prepare(root, preset, meshes, replacing=replacing)
        scenes = (write_scene(root, drawn(index), maker) for index in range(preset.dataset.count))
        return finish(root, preset, meshes, reported(scenes, on_scene), maker.version)


def prepare(root: Path, preset: Preset, meshes: Mapping[str, str], *, replacing: bool) -> None:
    """Check the folder; remove scenes beyond those of the preset, and the renders of a dataset to replace."""
    check_target(root, preset, meshes, replacing=replacing)
    if replacing and losses(root, preset, meshes):
        remove_renders(root)
    for entry in surplus(root, preset.dataset.count):
        shutil.rmtree(entry)


def finish(
    root: Path, preset: Preset, meshes: Mapping[str, str], scenes: Iterable[SceneEntry], version: str
) -> Dataset:
    """Collect the scenes as they are made, then write the index."""
    index = build_index(preset, scenes, version, meshes=meshes)
    write_index(root, index)
    return open_dataset(root)


def reported(scenes: Iterable[SceneEntry], on_scene: Callable[[], None]) -> Iterator[SceneEntry]:
    """Yield the scenes; call `on_scene` before each."""
    for scene in scenes:
        on_scene()
        yield scene


def write_scene(root: Path, scene: Scene, maker: Maker) -> SceneEntry:
    """Write the folder of a scene, unless it already has exactly these bytes.

    Raises
    ------
    DatasetError : the folder has a file that no scene of this kind has.
    """
    files = maker.files(scene)
    folder = inside(root, "scenes", scene.id)
    if not _holds(folder, files):
        if folder.is_dir():
            refuse_files_of_others(entry for entry in folder.iterdir() if entry.name not in files)
        with whole_folder(folder, sweep=False) as partial:  # `prepare` has removed the leftovers
            for name, contents in files.items():
                (partial / name).write_bytes(contents)
    return scene_entry(scene, files)


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Whether a folder has exactly these files with exactly these bytes."""
    try:
        if {entry.name for entry in folder.iterdir()} != set(files):
            return False
        return all(read_plain(folder / name, MOST_FILE_BYTES) == contents for name, contents in files.items())
    except OSError:
        return False
