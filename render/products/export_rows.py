"""The rows of an exported dataset, written one by one into a new HDF5 file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np
from numpy.typing import NDArray

from render.products.deferred_error_file import hdf5_file
from render.products.export_format import (
    ABOUT,
    DOCUMENTS,
    FORMAT,
    FORMAT_VERSION,
    FREQUENCIES,
    IMAGES,
    NO_ROUGHNESS,
    ROUGHNESS,
    SPLIT_ROWS,
    TEXT,
    TEXTS,
    VIEWS,
    ArrayKind,
)
from render.products.export_scenes import ExportedScene
from scenegen import SceneEntry, Split

_STREAMED = ("scene", "render")  # texts that are written row by row
_CHUNK_BYTES = 2**20  # image rows of one scene; HDF5 caches at least as much
_TEXT_ROWS = 64  # in a chunk


@dataclass
class Rows:
    """The rows of a file; those that are not images or long texts are kept until `finish`.

    Attributes
    ----------
    file : the file, which is open.
    stop_if_needed : raises an `OSError` of writing, and handles signals (`hdf5_file`).
    most : number of rows that there may be.
    entries, roughness, views_deg : of the scenes that were added.
    shapes : shape of each array that has a row for each scene, by name, after `finish`.
    """

    file: h5py.File
    stop_if_needed: Callable[[], None]
    most: int
    entries: list[SceneEntry] = field(default_factory=list)
    roughness: list[float] = field(default_factory=list)
    views_deg: list[float] = field(default_factory=list)
    shapes: dict[str, tuple[int, ...]] = field(default_factory=dict)

    @property
    def split_counts(self) -> dict[str, int]:
        """Number of rows of each split."""
        return {split: len(self._rows_of(split)) for split in get_args(Split)}

    def add(self, entry: SceneEntry, scene: ExportedScene) -> None:
        """Add a scene. All scenes have images of the same names and shapes.

        Raises
        ------
        OSError : the file cannot be written, as on a full disk.
        """
        row = len(self.entries)
        if row == 0:
            self._create(scene.images)
        for name, values in scene.images.items():
            self.file[name][row] = values
        self.file["scene"][row], self.file["render"][row] = scene.scene_text, scene.render_text
        self.entries.append(entry)
        self.roughness.append(scene.scene.relay_wall.roughness or NO_ROUGHNESS)
        self.views_deg.append(scene.scene.camera.horizontal_fov_deg)
        self.stop_if_needed()

    def finish(
        self, frequencies_hz: Sequence[float], documents: Mapping[str, Any], licence: str | None
    ) -> None:
        """Write all that is not a row of images, and cut off the rows that were not needed.

        Parameters
        ----------
        documents : plain data of each of `render.products.export_format.DOCUMENTS`.
        """
        for name in (*IMAGES, *_STREAMED):
            if name in self.file:
                self.file[name].resize(len(self.entries), axis=0)
        self._write_texts("scene_id", [entry.id for entry in self.entries])
        self._write_texts("object_class", [entry.object_class for entry in self.entries])
        self._write_texts("split", [entry.split for entry in self.entries])
        self._write("roughness", self.roughness, ROUGHNESS)
        self._write("horizontal_fov_deg", self.views_deg, VIEWS)
        self.shapes = {name: array.shape for name, array in self.file.items()}
        for split in get_args(Split):
            self._write(f"splits/{split}", self._rows_of(split), SPLIT_ROWS)
        self._write("frequencies_hz", frequencies_hz, FREQUENCIES)
        for name, description in DOCUMENTS.items():
            text = json.dumps(documents[name], indent=1)
            array = self.file.create_dataset(name, data=text, dtype=h5py.string_dtype(), track_times=False)
            _describe(array, "", TEXT, description)
        about = {"format": FORMAT, "format_version": FORMAT_VERSION, "description": ABOUT}
        self.file.attrs.update(about if licence is None else {**about, "licence": licence})

    def _rows_of(self, split: str) -> list[int]:
        return [row for row, entry in enumerate(self.entries) if entry.split == split]

    def _create(self, images: Mapping[str, NDArray[Any]]) -> None:
        """The arrays that are written row by row, for scenes with images like these."""
        for name, values in images.items():
            kind, (height, *rest) = IMAGES[name], values.shape
            lines = _CHUNK_BYTES // (np.dtype(kind.dtype).itemsize * math.prod(rest))
            array = self.file.create_dataset(
                name,
                (self.most, height, *rest),
                kind.dtype,
                maxshape=(self.most, height, *rest),
                chunks=(1, min(height, max(1, lines)), *rest),
                compression="gzip",
                compression_opts=4,
                shuffle=True,
                fletcher32=True,
                track_times=False,
            )
            _describe(array, kind.axes, kind.units, kind.description)
        for name in _STREAMED:
            array = self.file.create_dataset(
                name,
                (self.most,),
                h5py.string_dtype(),
                maxshape=(self.most,),
                chunks=(min(self.most, _TEXT_ROWS),),
                track_times=False,
            )
            _describe(array, "N", TEXT, TEXTS[name])

    def _write(self, name: str, values: Sequence[float], kind: ArrayKind) -> None:
        array = self.file.create_dataset(name, data=np.array(values, kind.dtype), track_times=False)
        _describe(array, kind.axes, kind.units, kind.description)

    def _write_texts(self, name: str, texts: list[str]) -> None:
        array = self.file.create_dataset(name, data=texts, dtype=h5py.string_dtype(), track_times=False)
        _describe(array, "N", TEXT, TEXTS[name])


@contextmanager
def new_rows(path: Path, most: int) -> Iterator[Rows]:
    """A new file for at most so many rows; `OSError` at the end if it could not be written."""
    with hdf5_file(path) as (file, stop_if_needed):
        yield Rows(file, stop_if_needed, most)


def _describe(array: h5py.Dataset, axes: str, units: str, description: str) -> None:
    array.attrs["axes"], array.attrs["units"], array.attrs["description"] = axes, units, description
