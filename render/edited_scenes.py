"""Scenes whose files are not those that ``dataset.json`` vouches for. Does not import Mitsuba."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from disk import NightError
from render.settings import RenderError
from scenegen import Dataset, Scene
from scenegen.mesh_places import misplaced
from scenegen.scene_folder import differences, folder_digest, ineffective, read_scene_folder, scene_of

SCENE_FILES = "scene_files"  # attribute of renders of such scenes


def known_digest(dataset: Dataset, scene_id: str) -> str:
    """Digest of a scene's files; empty if they are missing or unreadable, which rendering then reports."""
    try:
        return folder_digest(dataset.scene_folder(scene_id))
    except (OSError, NightError):
        return ""


def is_edited(dataset: Dataset, scene_id: str, digest: str) -> bool:
    """Whether the files with this digest are not those of ``dataset.json``."""
    return dataset.entry(scene_id).sha256 != digest


def edited_attributes(dataset: Dataset, scene_id: str, digest: str) -> dict[str, str]:
    """Provenance of a render from files with this digest; empty for files as night-gen made them."""
    return {SCENE_FILES: "edited"} if is_edited(dataset, scene_id, digest) else {}


def refuse_measured(dataset: Dataset) -> None:
    """`RenderError` for a dataset of captures: a render would take the place of what a camera measured."""
    if dataset.is_measured:
        raise RenderError(
            f"{dataset.root} holds captures of a camera: there is nothing to render, train on it as it is"
        )


def refuse_edited(dataset: Dataset, scenes: Sequence[str]) -> None:
    """Refuse to render `scenes`, all of which are edited, if there are any.

    Raises
    ------
    RenderError : names the first scene, what differs as far as its files tell, and what to do.
    """
    if not scenes:
        return
    first = scenes[0]
    others = f" (and {len(scenes) - 1} more)" if len(scenes) > 1 else ""
    raise RenderError(
        f"scene {first}{others} is not as night-gen made it: {differences(dataset.scene_folder(first))}; "
        f"night-gen scenes {dataset.root} repairs it, and --accept edited renders it as it is"
    )


def without_effect(dataset: Dataset, scenes: Sequence[str]) -> str:
    """A sentence about changes in Mitsuba's scene files among `scenes`; empty if there are none."""
    found = []
    for scene_id in scenes:
        folder = dataset.scene_folder(scene_id)
        try:
            files = read_scene_folder(folder)
            found += [folder / name for name in ineffective(files, scene_of(files, folder))]
        except (OSError, NightError):
            continue  # rendering reports it
    if not found:
        return ""
    others = f" and {len(found) - 1} more such files differ" if len(found) > 1 else " differs"
    return (
        f"{found[0]}{others} from scene.json, which has no effect: scenes are rendered from scene.json and "
        "the meshes"
    )


def refuse_unlike(scene: Scene, dataset: Dataset, files: Mapping[str, bytes], digest: str) -> None:
    """Refuse a scene that would be rendered otherwise than it says; night-gen makes none.

    Parameters
    ----------
    files, digest : of the scene's folder.
    """
    folder = dataset.scene_folder(scene.id)
    if is_edited(dataset, scene.id, digest) and (problem := misplaced(scene, files, folder)):
        raise RenderError(f"scene {scene.id}: {problem}")
    seen, camera = scene.camera, dataset.preset.camera
    if seen.width * camera.height != seen.height * camera.width:
        raise RenderError(
            f"scene {scene.id}: its camera has {seen.width}x{seen.height} pixels, another shape than the "
            f"{camera.width}x{camera.height} of the dataset: change the camera in scene.json"
        )
