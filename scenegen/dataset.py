"""The dataset folder, through which all stages exchange their files (docs/reference/files.md).

It contains ``dataset.json``, ``scenes/<id>/{scene.json,scene.xml,mirrored.xml,*.ply}``, ``renders/<id>/...``
and ``shards/...``; ids are zero-padded indices. No path of a `Dataset` leads out of its folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Final, Literal, get_args

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from disk.contract import STRICT, ContractError, checked
from disk.counted import counted
from disk.extras import installed_versions
from disk.inner_paths import inside
from disk.night_error import NightError
from disk.path_like import PathLike
from disk.plain_file import MOST_LIST_BYTES, read_plain, read_text
from disk.quantities import ClassName
from disk.told import Told
from disk.whole_writing import write_text
from scenegen.preset import Preset
from scenegen.render_folder import Sha256
from scenegen.rendering_record import RenderingRecord, read_rendering_record
from scenegen.scene import Scene, Split
from scenegen.scene_folder import SCENE_FILE, digest_of, scene_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DATASET_SCHEMA: Final = 4
MEASURED_GENERATOR = "night-eval capture pairs"  # of datasets whose measurements are those of a camera
_MOST_PLOTTED: Final = 500  # scenes from above
_PACKAGES = ("night-nlos", "bpy", "numpy", "trimesh")  # what a scene's bytes may depend on


class DatasetError(NightError):
    """A dataset folder that is missing, foreign, of another schema or incomplete."""


@dataclass(frozen=True, config=STRICT)
class SceneEntry:
    """Id, class and split of one scene.

    `sha256` is the digest of its folder (`scenegen.scene_folder.digest_of`) as night-gen made it;
    ``dataset.json`` has it, shards do not. The text form has no digest, because the hash of training data is
    made from it.
    """

    id: Annotated[str, Field(pattern=r"^[0-9]{6,}$")]
    object_class: ClassName
    split: Split
    sha256: Annotated[Sha256 | None, Field(exclude_if=lambda value: value is None)] = field(
        default=None, repr=False
    )


@dataclass(frozen=True, config=STRICT)
class DatasetIndex:
    """Contents of ``dataset.json``.

    Attributes
    ----------
    generator, generator_version, blender_version : the programs that made the scenes.
    seed : seed of the dataset.
    preset : all settings, as resolved when the dataset was made.
    scenes : the scene list.
    packages : versions of the packages that the scenes' bytes depend on, by name.
    meshes : SHA-256 of the mesh files that the preset names, by shape.
    """

    generator: str
    generator_version: str
    blender_version: str
    seed: Annotated[int, Field(ge=0)]
    preset: Preset
    scenes: Annotated[tuple[SceneEntry, ...], Field(min_length=1)]
    packages: dict[str, str] = Field(default_factory=dict)
    meshes: dict[str, str] = Field(default_factory=dict)
    schema_version: Literal[4] = DATASET_SCHEMA

    def __post_init__(self) -> None:
        if len({entry.id for entry in self.scenes}) < len(self.scenes):
            raise ValueError("two scenes have the same id")
        if not all(entry.sha256 for entry in self.scenes):
            raise ValueError("a scene has no sha256")


@plain_dataclass(frozen=True, repr=False)
class Dataset(Told):
    """An opened dataset folder."""

    root: Path
    index: DatasetIndex

    def __repr__(self) -> str:
        return self.sentences[0]

    @property
    def sentences(self) -> tuple[str]:
        """How many scenes of which splits."""
        return (f"Dataset of {self.sentence()}",)

    @property
    def preset(self) -> Preset:
        """All settings of the dataset, as resolved when it was made."""
        return self.index.preset

    @property
    def is_measured(self) -> bool:
        """Whether its images are captures of a camera, and its scenes only describe them."""
        return self.index.generator == MEASURED_GENERATOR

    @property
    def rendering(self) -> RenderingRecord | None:
        """How the dataset was rendered; None when it has not been rendered. The file is read at every call.

        Raises
        ------
        DatasetError : ``renders/rendering.json`` is damaged.
        """
        try:
            return read_rendering_record(self.renders)
        except ContractError as error:
            raise DatasetError(str(error)) from None

    @cached_property
    def renders(self) -> Path:
        """Folder of all renders."""
        return inside(self.root, "renders")

    def ids(self, split: Split | None = None) -> list[str]:
        """Scene ids in ascending order, of one split or of all scenes."""
        return [entry.id for entry in self.index.scenes if split in (None, entry.split)]

    def sentence(self) -> str:
        """Number of scenes in each split, as a sentence."""
        parts = [f"{len(self.ids(split))} {split}" for split in get_args(Split)]
        return f"{counted(len(self.ids()), 'scene')} in {self.root}: {', '.join(parts)}"

    def entry(self, scene: str) -> SceneEntry:
        """Class and split of a scene; `DatasetError` when the dataset does not have it."""
        if scene in self._entries:
            return self._entries[scene]
        raise DatasetError(
            f"{self.root} has no scene {scene}: its ids run from {self.index.scenes[0].id} "
            f"to {self.index.scenes[-1].id}"
        )

    @cached_property
    def _entries(self) -> dict[str, SceneEntry]:
        return {entry.id: entry for entry in self.index.scenes}

    @cached_property
    def _scenes(self) -> Path:
        return inside(self.root, "scenes")

    def scene_folder(self, scene: str) -> Path:
        """Folder of a scene's description and meshes."""
        return inside(self._scenes, scene)

    def render_folder(self, scene: str) -> Path:
        """Folder of a scene's renders."""
        return inside(self.renders, scene)

    @property
    def shard_folder(self) -> Path:
        """Folder of the arrays that training reads."""
        return inside(self.root, "shards")

    def plot(self) -> Figure:
        """Walls, cameras and hidden objects from above, of the first 500 scenes."""
        from scenegen.plan import plot_plan

        return plot_plan([self.scene(each) for each in self.ids()[:_MOST_PLOTTED]])

    def scene(self, scene: str) -> Scene:
        """The scene's data; `DatasetError` when its file is missing or damaged."""
        folder = self.scene_folder(scene)
        try:
            file = inside(folder, SCENE_FILE)
            return scene_of({SCENE_FILE: read_plain(file)} if file.exists() else {}, folder)
        except ContractError as error:
            raise DatasetError(str(error)) from None
        except OSError as error:
            raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from None


def scene_entry(scene: Scene, files: Mapping[str, bytes]) -> SceneEntry:
    """Entry of a scene whose folder has these files."""
    return SceneEntry(scene.id, scene.object_class, scene.split, digest_of(files))


def build_index(
    preset: Preset,
    scenes: Iterable[SceneEntry],
    blender_version: str,
    *,
    meshes: Mapping[str, str] = MappingProxyType({}),
) -> DatasetIndex:
    """The index of `scenes`; `meshes` has the SHA-256 of the mesh files that `preset` names, by shape."""
    return DatasetIndex(
        generator="night-gen",
        generator_version=version("night-nlos"),
        blender_version=blender_version,
        seed=preset.dataset.seed,
        preset=preset,
        scenes=tuple(scenes),
        packages=installed_versions(_PACKAGES),
        meshes=dict(meshes),
    )


def write_index(root: PathLike, index: DatasetIndex) -> None:
    """Write ``dataset.json``, complete or not at all."""
    text = TypeAdapter(DatasetIndex).dump_json(index, indent=2).decode()
    write_text(Path(root, "dataset.json"), text + "\n")


def open_dataset(root: PathLike) -> Dataset:
    """Open a dataset folder.

    Raises
    ------
    DatasetError : the folder is missing, is not a dataset, or has another schema, or its ``dataset.json`` is
        damaged; the message names the key.
    OutsideError : its folder of scenes, renders or shards is a symbolic link that leads out of it.
    """
    root = Path(root)
    file = root / "dataset.json"
    if root.exists() and not root.is_dir():
        raise DatasetError(f"{root} is a file: give the folder of a dataset")
    if not root.is_dir():
        raise DatasetError(f"there is no folder {root}: make a dataset with night-gen scenes {root}")
    try:
        text = read_text(file, MOST_LIST_BYTES)
        data = json.loads(text)
    except FileNotFoundError:
        raise DatasetError(
            f"{root} is not a NIGHT dataset (it has no dataset.json): make one with night-gen scenes"
        ) from None
    except OSError as error:
        raise DatasetError(f"{file} cannot be read: {error.strerror or error}") from None
    except UnicodeError as error:
        raise DatasetError(f"{file} cannot be read: {error}") from None
    except (ValueError, RecursionError) as error:  # also numbers too long, and lists too deep
        raise DatasetError(f"{file} cannot be read as JSON: {error}") from None
    schema = data.get("schema_version") if isinstance(data, dict) else None
    if schema != DATASET_SCHEMA:
        raise DatasetError(
            f"{file} has schema version {schema}, this program reads version {DATASET_SCHEMA}: "
            "make the dataset again, or use the version of NIGHT that made it"
        )
    for name in ("scenes", "renders", "shards"):
        inside(root, name)
    return Dataset(root, checked(TypeAdapter(DatasetIndex), text, str(file), DatasetError))
