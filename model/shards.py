"""Shards: a dataset's renders as a few float32 arrays that training reads memory-mapped.

``shards/`` of a dataset holds ``phasors.npy`` (N, 2F, H, W: F real parts, then F imaginary parts),
``target.npy`` (N, 2, H, W), ``radial_depth_m.npy`` (N, H, W), ``mask.npy`` (N, H, W, uint8),
``reference.npy`` (2F, H, W: the direct return of the bare relay wall) and ``manifest.json``, which knows
the SHA-256 of every render they were made of and of every array. Half floats would destroy the hidden
0.1-0.3 % of the signal (DESIGN 4.2), so phasors are float32.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass as plain_dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from tqdm import tqdm

from itof import direct_phasors, join_components, split_components
from model.renders import RenderedScene, ShardError, read_render, source_files
from scenegen import Dataset, SceneEntry, Split, camera_axes, wall_normal, whole_folder
from scenegen.preset import STRICT, Preset, WholeCount

SHARD_SCHEMA: Final = 1
ARRAYS = ("phasors", "target", "radial_depth_m", "mask", "reference")
_log = logging.getLogger(__name__)


@dataclass(frozen=True, config=STRICT)
class ShardManifest:
    """Contents of ``manifest.json``: what the arrays hold and what they were made of.

    Attributes
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    width, height : image size, pixels.
    preset_sha256 : of the dataset's resolved preset (camera and relay wall shape the reference).
    scenes : id, class and split of each row of the arrays.
    sources : SHA-256 of every render, by its path in the dataset.
    arrays : SHA-256 of every array file, by its name.
    """

    frequencies_hz: tuple[float, ...]
    width: WholeCount
    height: WholeCount
    preset_sha256: str
    scenes: tuple[SceneEntry, ...]
    sources: dict[str, str]
    arrays: dict[str, str]
    schema_version: Literal[1] = SHARD_SCHEMA

    @property
    def data_sha256(self) -> str:
        """One hash for all that training could see: scenes, splits, preset and renders."""
        seen = (self.preset_sha256, self.scenes, sorted(self.sources.items()))
        return hashlib.sha256(repr(seen).encode()).hexdigest()


@plain_dataclass(frozen=True)
class Shards:
    """Opened shards; the arrays are memory-mapped and read-only.

    Attributes
    ----------
    manifest : what they hold.
    phasors : (N, 2F, H, W) float32.
    target : (N, 2, H, W) float32, Re and Im of the mirrored scene at the first frequency.
    radial_depth_m : (N, H, W) float32, 0 on background.
    mask : (N, H, W) uint8.
    reference : (H, W, F) complex, the direct return of the bare relay wall.
    """

    manifest: ShardManifest
    phasors: NDArray[np.float32]
    target: NDArray[np.float32]
    radial_depth_m: NDArray[np.float32]
    mask: NDArray[np.uint8]
    reference: NDArray[np.complex128]

    def rows(self, split: Split) -> list[int]:
        """Rows of the arrays that belong to a split, in scene order."""
        return [row for row, scene in enumerate(self.manifest.scenes) if scene.split == split]

    def ids(self, rows: Sequence[int]) -> list[str]:
        """Scene ids of rows."""
        return [self.manifest.scenes[row].id for row in rows]

    def complex_phasors(self, rows: Sequence[int]) -> NDArray[np.complex128]:
        """(n, H, W, F) phasors of some rows, read from disk now."""
        return join_components(np.moveaxis(self.phasors[list(rows)], 1, -1))


def open_shards(dataset: Dataset, *, progress: bool = False) -> Shards:
    """Shards of a dataset; built first when there are none, or none that still fit its renders.

    Raises
    ------
    ShardError, ImageFileError : renders that are missing, damaged, not finite or of several sizes.
    OSError : the disk is full.
    """
    sources = {name: _sha256(path) for name, path in source_files(dataset).items()}
    reason = _why_stale(dataset, sources)
    if reason:
        _log.info("building %s from %d scenes: %s", dataset.shard_folder, len(dataset.ids()), reason)
        _build(dataset, sources, progress)
    return _open(dataset.shard_folder)


def preset_sha256(preset: Preset) -> str:
    """SHA-256 of a resolved preset."""
    return hashlib.sha256(TypeAdapter(Preset).dump_json(preset)).hexdigest()


def _why_stale(dataset: Dataset, sources: Mapping[str, str]) -> str | None:
    """What keeps the shards on disk from being used, in words; None when nothing does."""
    folder = dataset.shard_folder
    try:
        manifest = _read_manifest(folder)
    except FileNotFoundError:
        return "there are none yet"
    except (OSError, ValidationError) as error:
        return f"their manifest cannot be used ({str(error).splitlines()[0]})"
    if manifest.scenes != dataset.index.scenes:
        return "the list of scenes changed"
    if manifest.preset_sha256 != preset_sha256(dataset.preset):
        return "the preset changed"
    changed = sorted(name for name, digest in sources.items() if manifest.sources.get(name) != digest)
    if changed:
        return f"{len(changed)} renders changed, first {changed[0]}"
    damaged = [name for name in ARRAYS if _damaged(folder / f"{name}.npy", manifest.arrays.get(name))]
    return f"{damaged[0]}.npy is missing or damaged" if damaged else None


def _build(dataset: Dataset, sources: Mapping[str, str], progress: bool) -> None:
    """Write the shard folder, scene by scene, whole or not at all."""
    scenes = dataset.ids()
    frequencies_hz = dataset.preset.itof.frequencies_hz
    first = read_render(dataset, scenes[0])
    height, width = first.mask.shape
    with whole_folder(dataset.shard_folder) as partial:
        _write_scenes(dataset, partial, first, progress)
        reference = split_components(_reference(dataset, width, height))  # (H, W, 2F)
        np.save(partial / "reference.npy", np.moveaxis(reference, -1, 0).astype(np.float32))
        manifest = ShardManifest(
            frequencies_hz=frequencies_hz,
            width=width,
            height=height,
            preset_sha256=preset_sha256(dataset.preset),
            scenes=dataset.index.scenes,
            sources=dict(sources),
            arrays={name: _sha256(partial / f"{name}.npy") for name in ARRAYS},
        )
        text = TypeAdapter(ShardManifest).dump_json(manifest, indent=1)
        (partial / "manifest.json").write_bytes(text + b"\n")


def _write_scenes(dataset: Dataset, folder: Path, first: RenderedScene, progress: bool) -> None:
    """Stream every scene into the arrays; memory stays that of one scene."""
    scenes = dataset.ids()
    height, width, frequency_count = first.phasor.shape

    def create(name: str, dtype: type, *axes: int) -> NDArray[np.generic]:
        shape = (len(scenes), *axes, height, width)
        return np.lib.format.open_memmap(folder / f"{name}.npy", mode="w+", dtype=dtype, shape=shape)

    phasors = create("phasors", np.float32, 2 * frequency_count)  # real and imaginary parts, not a path
    target = create("target", np.float32, 2)
    radial_depth_m, mask = create("radial_depth_m", np.float32), create("mask", np.uint8)
    for row, scene in enumerate(tqdm(scenes, desc="shards", unit="scene", disable=not progress or None)):
        rendered = read_render(dataset, scene)
        if rendered.size != first.size:
            raise ShardError(
                f"wrong resolution between stages: scene {scene} was rendered at {rendered.size} pixels, "
                f"scene {scenes[0]} at {first.size}; render them all at one resolution"
            )
        phasors[row] = np.moveaxis(split_components(rendered.phasor), -1, 0)
        target[row], radial_depth_m[row], mask[row] = rendered.target, rendered.radial_depth_m, rendered.mask
    for array in (phasors, target, radial_depth_m, mask):
        if isinstance(array, np.memmap):
            array.flush()


def _reference(dataset: Dataset, width: int, height: int) -> NDArray[np.complex128]:
    """(H, W, F) direct return of the bare relay wall; camera and wall are the same in every scene."""
    scene = dataset.scene(dataset.ids()[0])
    return direct_phasors(
        width,
        height,
        scene.camera.horizontal_fov_deg,
        dataset.preset.itof.frequencies_hz,
        camera_axes(scene.camera),
        scene.camera.location_m,
        scene.relay_wall.location_m,
        wall_normal(scene.relay_wall),
    )


def _open(folder: Path) -> Shards:
    arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r", allow_pickle=False) for name in ARRAYS}
    reference = join_components(np.moveaxis(np.array(arrays.pop("reference")), 0, -1))  # (H, W, F)
    return Shards(manifest=_read_manifest(folder), reference=reference, **arrays)


def _read_manifest(folder: Path) -> ShardManifest:
    return TypeAdapter(ShardManifest).validate_json((folder / "manifest.json").read_bytes())


def _damaged(file: Path, digest: str | None) -> bool:
    return not file.is_file() or _sha256(file) != digest


def _sha256(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
