"""Writes the preview of a dataset into its folder: contact sheet, distributions and card."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from disk import NightError, inside, whole_file, write_text
from disk.plain_file import read_plain
from itof.pictures.png import save_png
from render.products.card import (
    CARD_FILE,
    CONTACT_SHEET,
    DISTRIBUTIONS,
    CardError,
    checked_licence,
    dataset_card,
    read_card,
)
from render.products.contact_sheet import contact_sheet
from render.products.croissant import CROISSANT_FILE, croissant, has_no_other_croissant
from render.products.distributions import distributions_figure, read_distributions
from render.products.tiles import PICTURE_SIZE, read_tile
from render.settings import RenderError
from scenegen import Dataset, Scene
from scenegen.making.meshes import UserMesh
from scenegen.scene_folder import MOST_FILE_BYTES
from scenegen.shapes import MESH_PREFIX
from scenegen.unit_meshes import unit_mesh_of_part

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Picture = Callable[[Scene, int, int], NDArray[np.uint8]]
_DOTS_PER_INCH = 110
_HEAD_BYTES = 1024  # of a PNG file, with the name of the program that wrote it


def write_preview(
    dataset: Dataset,
    ids: Sequence[str],
    picture: Picture,
    licence: str | None = None,
    on_step: Callable[[], object] = lambda: None,
) -> list[Path]:
    """Write the preview of a dataset.

    Parameters
    ----------
    ids : scenes of the contact sheet.
    picture : function of scene, width and height that returns an (H, W, 3) view, like
        `scenegen.making.blender.BlenderMaker.picture`.
    licence : licence of the dataset for its card; None keeps the licence in the card.
    on_step : called once for every scene of the dataset, and once more for every one of `ids`.

    Returns
    -------
    The files that were written. A README.md or croissant.json that this program did not write is kept and not
    among them; without its README.md, neither is written.

    Raises
    ------
    CardError : the licence is empty, or a picture of another program has the name of one of the preview.
    RenderFileError, ImageFileError, RenderError : a render is damaged.
    DatasetError : a scene is missing or damaged.
    """
    chosen = None if licence is None else checked_licence(licence)
    _refuse_other_pictures(dataset)
    found = read_distributions(dataset, on_step)
    tiles = []
    for scene_id in ids:
        tiles.append(read_tile(dataset, scene_id, picture(dataset.scene(scene_id), *PICTURE_SIZE)))
        on_step()
    written = [
        _write_figure(inside(dataset.root, CONTACT_SHEET), contact_sheet(tiles)),
        _write_figure(inside(dataset.root, DISTRIBUTIONS), distributions_figure(found, dataset.preset)),
    ]
    earlier = read_card(dataset)
    if earlier.is_ours:
        kept = chosen or earlier.licence
        cards = {}
        if has_no_other_croissant(dataset):
            cards[CROISSANT_FILE] = croissant(dataset, found, kept)
        cards[CARD_FILE] = dataset_card(dataset, found, kept)
        for name, text in cards.items():
            write_text(dataset.root / name, text)
            written.append(dataset.root / name)
    return written


def check_preview(dataset: Dataset, ids: Sequence[str], licence: str | None) -> None:
    """Raise the errors of `write_preview` for the licence and the renders of `ids`, without drawing."""
    if licence is not None:
        checked_licence(licence)
    _refuse_other_pictures(dataset)
    width, height = PICTURE_SIZE
    for scene_id in ids:
        read_tile(dataset, scene_id, np.zeros((height, width, 3), np.uint8))


def _refuse_other_pictures(dataset: Dataset) -> None:
    """Refuse to replace a picture that Matplotlib, which draws the preview, did not write."""
    for name in (CONTACT_SHEET, DISTRIBUTIONS):
        file = inside(dataset.root, name)
        if not file.exists():
            continue
        head = b""
        if file.is_file():
            with file.open("rb") as stream:
                head = stream.read(_HEAD_BYTES)
        if b"Software\0Matplotlib" not in head:
            raise CardError(
                f"{file} is not a picture that night-gen preview wrote and would be replaced: rename it"
            )


def meshes_in(dataset: Dataset, ids: Sequence[str]) -> dict[str, UserMesh]:
    """The users' own meshes in the scenes `ids`, by shape, from the files of the scenes.

    The mesh files that the user gave are not needed.

    Raises
    ------
    RenderError : the mesh of a scene is missing or damaged.
    """
    meshes: dict[str, UserMesh] = {}
    for scene_id in ids:
        for number, part in enumerate(dataset.scene(scene_id).hidden_objects):
            if not part.shape.startswith(MESH_PREFIX) or part.shape in meshes:
                continue
            file = inside(dataset.scene_folder(scene_id), f"hidden_object_{number}.ply")
            try:
                mesh = unit_mesh_of_part(part, read_plain(file, MOST_FILE_BYTES), str(file))
            except (OSError, NightError) as error:
                why = error.strerror if isinstance(error, OSError) else error
                raise RenderError(f"{file} cannot be read ({why}): run night-gen scenes again") from None
            sha256 = dataset.index.meshes.get(part.shape, "")
            meshes[part.shape] = UserMesh(mesh.vertices, mesh.triangles, mesh.outermost, sha256)
    return meshes


def _write_figure(file: Path, figure: Figure) -> Path:
    with whole_file(file) as partial:
        save_png(figure, partial, _DOTS_PER_INCH)
    return file
