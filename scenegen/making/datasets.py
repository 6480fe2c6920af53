"""Making a dataset from Python, in one call."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from disk.extras import need
from disk.path_like import PathLike
from disk.preset_files import read_settings
from processes.progress import showing_progress
from scenegen.corner_check import refuse_impossible_corner
from scenegen.dataset import Dataset
from scenegen.making.generation_pool import generate_in_processes
from scenegen.making.meshes import with_meshes
from scenegen.preset import Preset, preset_from_dict


def make_dataset(
    out: PathLike,
    preset: Preset | PathLike,
    *,
    mesh_folder: PathLike | None = None,
    replace: bool = False,
    workers: int = 1,
    progress: bool = True,
) -> Dataset:
    """Make the scenes of a preset in the folder `out`, as ``night-gen scenes`` does.

    Blender runs in processes of its own, not in this one, where it would disturb other libraries. A second
    call continues an interrupted one, repairs damaged scenes, and adds scenes where the preset now asks for
    more.

    Parameters
    ----------
    out : folder of the dataset; made if missing.
    preset : the settings, or the name or file of a preset as `scenegen.load_preset` takes it.
    mesh_folder : folder of the files that the shapes ``mesh:FILE`` name; None for the folder of the preset's
        file, or the working directory where `preset` is no file.
    replace : whether a dataset of another preset in `out` is replaced; its renders are deleted.
    workers : number of processes, 350 MB each; the dataset is the same.
    progress : whether to show the progress.

    Raises
    ------
    PresetError : there is no such preset, or it asks for something impossible.
    MeshError : a mesh cannot be used.
    DatasetError : `out` has other files, or a dataset of another preset or seed.
    SamplingError : the preset's ranges leave an object no room.
    WorkerError : a process was killed.
    """
    settings, folder = _read(preset)
    settings, meshes = with_meshes(settings, folder if mesh_folder is None else Path(mesh_folder))
    refuse_impossible_corner(settings, meshes)
    with showing_progress(settings.dataset.count, "scene", "scenes", show=progress) as bar:
        return generate_in_processes(
            Path(out),
            settings,
            functools.partial(blender_maker, meshes),
            bar.update,
            workers=workers,
            meshes={shape: mesh.sha256 for shape, mesh in meshes.items()},
            replacing=replace,
        )


def blender_maker(meshes: Mapping[str, Any]) -> Any:
    """Start Blender in this process, and return the `BlenderMaker` of scenes with these meshes."""
    need("scenes", ("bpy",), "making or drawing scenes")
    from scenegen.making.blender import BlenderMaker

    return BlenderMaker(meshes)


def _read(preset: Preset | PathLike) -> tuple[Preset, Path]:
    """The settings of a preset, and its folder."""
    if isinstance(preset, Preset):
        return preset, Path()
    data, origin = read_settings("presets", preset)
    return preset_from_dict(data, origin), Path(origin).parent
