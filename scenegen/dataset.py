"""The dataset folder: a contract between all stages.

``dataset.json``, ``scenes/<id>/{scene.json,scene.xml,mirrored.xml,*.ply}``, ``renders/<id>/...``,
``shards/...``; ids are zero-padded indices.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass as plain_dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal, get_args

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from scenegen.contract import STRICT, ContractError, checked
from scenegen.files.whole_files import write_text
from scenegen.night_error import NightError
from scenegen.preset import Preset
from scenegen.rendering_record import RenderingRecord, read_rendering_record
from scenegen.scene import Scene, Split, scene_from_json, scene_id

DATASET_SCHEMAS = (1, 2, 3)  # readable; the newest is written
_PACKAGES = ("night-nlos", "bpy", "numpy", "trimesh")  # what a scene's bytes may depend on


class DatasetError(NightError):
    """A dataset folder that is missing, foreign, of another schema or incomplete."""


@dataclass(frozen=True, config=STRICT)
class SceneEntry:
    """One line of the scene list."""

    id: str
    object_class: str
    split: Split


@dataclass(frozen=True, config=STRICT)
class DatasetIndex:
    """Contents of ``dataset.json``: what was asked for, by what it was made, and the scene list.

    `packages` are the versions of the programs that made the scenes, `meshes` the SHA-256 of the mesh files
    a preset names. `rendering` is what datasets up to schema 2 say of their renders; it is not
    written any more.
    """

    generator: str
    generator_version: str
    blender_version: str
    seed: Annotated[int, Field(ge=0)]
    preset: Preset
    scenes: Annotated[tuple[SceneEntry, ...], Field(min_length=1)]
    packages: dict[str, str] = Field(default_factory=dict)
    meshes: dict[str, str] = Field(default_factory=dict)
    rendering: RenderingRecord | None = Field(default=None, exclude_if=lambda value: value is None)
    schema_version: Literal[1, 2, 3] = 3


@plain_dataclass(frozen=True)
class Dataset:
    """An opened dataset folder."""

    root: Path
    index: DatasetIndex

    @property
    def preset(self) -> Preset:
        """The preset as it was resolved when the dataset was made."""
        return self.index.preset

    @property
    def rendering(self) -> RenderingRecord | None:
        """How the dataset was rendered, read now; None when it was not.

        Raises
        ------
        ContractError : ``renders/rendering.json`` is damaged.
        """
        return read_rendering_record(self.renders) or self.index.rendering

    @property
    def renders(self) -> Path:
        """Folder of all that was rendered."""
        return self.root / "renders"

    def ids(self, split: Split | None = None) -> list[str]:
        """Scene ids in order, of one split or of all."""
        return [entry.id for entry in self.index.scenes if split in (None, entry.split)]

    def sentence(self) -> str:
        """How many scenes there are in each split, for people to read."""
        parts = [f"{len(self.ids(split))} {split}" for split in get_args(Split)]
        return f"{len(self.ids())} scenes in {self.root}: {', '.join(parts)}"

    def entry(self, scene: str) -> SceneEntry:
        """Class and split of a scene; `DatasetError` when there is no such scene."""
        if scene in self._entries:
            return self._entries[scene]
        raise DatasetError(
            f"{self.root} has no scene {scene}: its ids run from {self.index.scenes[0].id} "
            f"to {self.index.scenes[-1].id}"
        )

    @cached_property
    def _entries(self) -> dict[str, SceneEntry]:
        return {entry.id: entry for entry in self.index.scenes}

    def scene_folder(self, scene: str) -> Path:
        """Folder of a scene's description and meshes."""
        return self.root / "scenes" / scene

    def render_folder(self, scene: str) -> Path:
        """Folder of what was rendered of a scene."""
        return self.renders / scene

    @property
    def shard_folder(self) -> Path:
        """Folder of the arrays that training reads."""
        return self.root / "shards"

    def scene(self, scene: str) -> Scene:
        """The scene's data; `DatasetError` when its file is missing or damaged."""
        file = self.scene_folder(scene) / "scene.json"
        try:
            text = file.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise DatasetError(f"{file} is missing: run night-gen scenes again") from None
        except UnicodeDecodeError as error:
            raise DatasetError(f"{file} cannot be read: {error}") from None
        try:
            return scene_from_json(text, str(file))
        except ContractError as error:
            raise DatasetError(str(error)) from None


def build_index(
    preset: Preset,
    scenes: Iterable[Scene],
    blender_version: str,
    *,
    meshes: Mapping[str, str] = MappingProxyType({}),
) -> DatasetIndex:
    """The index of `scenes`, made from `preset` and from the `meshes` (shape to SHA-256) that it names."""
    return DatasetIndex(
        generator="night-gen",
        generator_version=version("night-nlos"),
        blender_version=blender_version,
        seed=preset.dataset.seed,
        preset=preset,
        scenes=tuple(
            SceneEntry(id=scene_id(s.index), object_class=s.object_class, split=s.split) for s in scenes
        ),
        packages={name: version(name) for name in _PACKAGES},
        meshes=dict(meshes),
    )


def write_index(root: Path, index: DatasetIndex) -> None:
    """Write ``dataset.json``, whole or not at all."""
    write_text(root / "dataset.json", TypeAdapter(DatasetIndex).dump_json(index, indent=2).decode() + "\n")


def open_dataset(root: Path) -> Dataset:
    """Open a dataset folder.

    Raises
    ------
    DatasetError : no such folder, not a dataset, one of another schema, or a ``dataset.json`` that breaks its
        contract; the message names the key.
    """
    file = root / "dataset.json"
    if not root.is_dir():
        raise DatasetError(f"there is no folder {root}: make a dataset with night-gen scenes {root}")
    try:
        text = file.read_text(encoding="utf-8")
        data = json.loads(text)
    except FileNotFoundError:
        raise DatasetError(
            f"{root} is no NIGHT dataset (it has no dataset.json): make one with night-gen scenes"
        ) from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DatasetError(f"{file} cannot be read as JSON: {error}") from None
    schema = data.get("schema_version") if isinstance(data, dict) else None
    if schema not in DATASET_SCHEMAS:
        raise DatasetError(
            f"{file} has schema version {schema}, this program reads versions up to {DATASET_SCHEMAS[-1]}: "
            "make the dataset again, or use the version of NIGHT that made it"
        )
    return Dataset(root, checked(TypeAdapter(DatasetIndex), text, str(file), DatasetError))
