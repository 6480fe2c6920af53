"""A Zarr folder with the arrays and attributes of an exported HDF5 file.

Zarr format 2, because format 3 has no settled kind of text. Arrays are cut into chunks of whole scenes, up to
about 1 MiB; each chunk is compressed with a checksum.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from disk import sha256_of
from processes import deferred_signals

_CHUNK_BYTES = 2**20
_LEVEL = 5  # of Zstandard
_TEXT_BYTES = 4096  # about, of a scene's text


def copy_to_zarr(file: Path, folder: Path) -> None:
    """Write all of the HDF5 file `file` into the empty folder `folder`; `OSError` on a full disk."""
    import zarr

    # A thread of zarr writes, and would go on after an exception in this one.
    with deferred_signals() as handle_signals, h5py.File(file) as source:
        root = zarr.open_group(folder, mode="a", zarr_format=2)
        root.attrs.update({name: _plain(value) for name, value in source.attrs.items()})
        # Not in a callback of `visititems`: it holds h5py's lock, and a thread of zarr that collects garbage
        # of h5py would wait for it for ever.
        names: list[str] = []
        source.visit(names.append)
        for name in names:
            if isinstance(item := source[name], h5py.Dataset):
                _copy_array(root, name, item, handle_signals)
        zarr.consolidate_metadata(root.store)


def digest_of_folder(folder: Path) -> tuple[int, str]:
    """Bytes of all files of a folder, and the SHA-256 of the list that ``sha256sum`` prints of them.

    That is the hash of the output of ``find . -type f | LC_ALL=C sort | xargs sha256sum`` in the folder.
    """
    names = sorted(f"./{file.relative_to(folder).as_posix()}" for file in folder.rglob("*") if file.is_file())
    lines = "".join(f"{sha256_of(folder / name)}  {name}\n" for name in names)
    return sum((folder / name).stat().st_size for name in names), hashlib.sha256(lines.encode()).hexdigest()


def _copy_array(root: Any, name: str, source: h5py.Dataset, handle_signals: Callable[[], None]) -> None:
    """Copy one array chunk by chunk."""
    from numcodecs import Shuffle, Zstd

    is_text = h5py.check_string_dtype(source.dtype) is not None
    count, *rest = source.shape or (1,)
    item_bytes = _TEXT_BYTES if is_text else source.dtype.itemsize * math.prod(rest)
    rows = min(max(1, count), max(1, _CHUNK_BYTES // max(1, item_bytes)))
    array = root.create_array(
        name,
        shape=source.shape,
        dtype=str if is_text else source.dtype,
        chunks=(rows, *rest) if source.shape else "auto",
        filters="auto" if is_text else [Shuffle(elementsize=np.zeros(1, source.dtype).real.dtype.itemsize)],
        compressors=Zstd(level=_LEVEL, checksum=True),
        fill_value="" if is_text else 0,
    )
    array.attrs.update({key: _plain(value) for key, value in source.attrs.items()})
    values = source.asstr() if is_text else source
    if not source.shape:
        array[()] = values[()]
        return
    for start in range(0, count, rows):
        array[start : start + rows] = values[start : start + rows]
        handle_signals()


def _plain(value: Any) -> Any:
    """An attribute as JSON has it."""
    return value.item() if isinstance(value, np.generic) else value
