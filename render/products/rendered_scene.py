"""The scene of a render, from files that are those which were rendered."""

from __future__ import annotations

from collections.abc import Mapping

from render.products.conversion import ExportError
from scenegen import Dataset, RenderRecord, Scene, read_recipe, read_record
from scenegen.scene_folder import digest_of, read_scene_folder, scene_of


def rendered_scene(dataset: Dataset, scene_id: str) -> Scene:
    """The scene that was rendered.

    Raises
    ------
    ExportError : the files of the scene are not those that were rendered, or, without a record of the render,
        not those of ``dataset.json``.
    NightError : a file of the scene is missing or damaged.
    """
    scene, _ = scene_and_files(dataset, scene_id, read_record(dataset.render_folder(scene_id)))
    return scene


def scene_and_files(
    dataset: Dataset, scene_id: str, record: RenderRecord | None
) -> tuple[Scene, Mapping[str, bytes]]:
    """As `rendered_scene`, with the contents of all files by name; `record` is that of the render."""
    folder = dataset.scene_folder(scene_id)
    files = read_scene_folder(folder)
    listed = dataset.entry(scene_id).sha256
    rendered = read_recipe(record.recipe).get("scene_sha256") if record else listed
    if rendered is not None and digest_of(files) != rendered:
        raise ExportError(
            f"the files in {folder} are not those that were rendered: run night-gen scenes {dataset.root}, "
            "which repairs them, then night-render"
        )
    return scene_of(files, folder), files
