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
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from scenegen.files.whole_files import write_text
from scenegen.night_error import NightError
from scenegen.preset import STRICT, Preset, WholeCount, checked
from scenegen.scene import Scene, Split, scene_from_json, scene_id

DATASET_SCHEMAS = (1, 2)  # readable; the newest is written, and 1 lacks all that has a default below
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
class RenderingProvenance:
    """How a dataset was rendered, for the record.

    Attributes
    ----------
    method, product, max_bounces : as given to ``night-render``.
    options : what the method was told, by name.
    width, height : image size, pixels.
    packages : versions of the programs that rendered.
    scene_count : how many scenes are rendered so.
    hidden_error_median, hidden_error_max : over scenes, the method's estimate of the error of the hidden
        phasors relative to them; None when it has none.
    """

    method: str
    product: str
    max_bounces: int
    options: dict[str, int | float | None]
    width: WholeCount
    height: WholeCount
    packages: dict[str, str]
    scene_count: Annotated[int, Field(ge=0)]
    hidden_error_median: float | None
    hidden_error_max: float | None


@dataclass(frozen=True, config=STRICT)
class DatasetIndex:
    """Contents of ``dataset.json``: what was asked for, by what it was made, and the scene list.

    `packages` are the versions of the programs that made the scenes, `meshes` the SHA-256 of the mesh files
    a preset names, `rendering` how the scenes were rendered.
    """

    generator: str
    generator_version: str
    blender_version: str
    seed: Annotated[int, Field(ge=0)]
    preset: Preset
    scenes: Annotated[tuple[SceneEntry, ...], Field(min_length=1)]
    packages: dict[str, str] = Field(default_factory=dict)
    meshes: dict[str, str] = Field(default_factory=dict)
    rendering: RenderingProvenance | None = None
    schema_version: Literal[1, 2] = 2


@plain_dataclass(frozen=True)
class Dataset:
    """An opened dataset folder."""

    root: Path
    index: DatasetIndex

    @property
    def preset(self) -> Preset:
        """The preset as it was resolved when the dataset was made."""
        return self.index.preset

    def ids(self, split: Split | None = None) -> list[str]:
        """Scene ids in order, of one split or of all."""
        return [entry.id for entry in self.index.scenes if split in (None, entry.split)]

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
        return self.root / "renders" / scene

    @property
    def shard_folder(self) -> Path:
        """Folder of the arrays that training reads."""
        return self.root / "shards"

    def scene(self, scene: str) -> Scene:
        """The scene's data; `DatasetError` when its file is gone, `PresetError` when it is damaged."""
        file = self.scene_folder(scene) / "scene.json"
        try:
            text = file.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise DatasetError(f"{file} is missing: run night-gen scenes again") from None
        return scene_from_json(text, str(file))


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
    DatasetError : no such folder, not a dataset, or one of another schema.
    PresetError : a ``dataset.json`` against the contract, by key.
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
    return Dataset(root, checked(TypeAdapter(DatasetIndex), text, str(file)))
