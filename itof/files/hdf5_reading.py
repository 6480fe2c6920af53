"""Data sets of an HDF5 file that lie in the file itself, uncompressed or in the common compressions.

HDF5 can do much more: a data set may be a link to another file, a mosaic of other files, raw bytes of any
file of the machine, or go through a filter that is loaded as a program. None of this is followed.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Final

import h5py
import numpy as np

from itof.arrays import Numbers
from itof.files.array_claims import Claims, RefusedError, check_claim

_MOST_NAMES = 1000  # that are listed
_LAYOUTS: Final = {h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED}
_FILTERS: Final = {
    h5py.h5z.FILTER_DEFLATE,
    h5py.h5z.FILTER_SHUFFLE,
    h5py.h5z.FILTER_FLETCHER32,
    h5py.h5z.FILTER_LZF,
}
_ERRORS = (OSError, RuntimeError, LookupError, ValueError, TypeError, AttributeError, OverflowError)


def read_hdf5(path: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Numbers], list[str]]:
    """The data sets among `wanted` that a file has, and the names of all that is in its root group.

    Raises
    ------
    RefusedError : it is no HDF5 file, is damaged, its data lie elsewhere, or claim more than it can hold.
    """
    try:
        with h5py.File(path, "r") as file:
            names = list(itertools.islice(file, _MOST_NAMES))
            claims = Claims(path)
            here = [name for name in dict.fromkeys(wanted) if _is_data_set(path, name, file)]
            found = {name: _read(claims, name, file) for name in here}
    except RefusedError:
        raise
    except _ERRORS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RefusedError(f"{path} cannot be read: it is damaged or no HDF5 file ({reason})") from None
    return found, names


def _is_data_set(path: Path, name: str, file: h5py.File) -> bool:
    """Whether there is a data set of this name; a link to one, or to a group that holds it, is refused."""
    place = ""
    for part in name.split("/"):
        place = f"{place}/{part}" if place else part
        try:
            link = file.get(place, getlink=True)
        except TypeError:  # a class of link that some program has added to HDF5
            link = None
        if link is None and place not in file:
            return False
        if not isinstance(link, h5py.HardLink):
            raise _elsewhere(path, place, "is a link")
    return isinstance(file[name], h5py.Dataset)


def _read(claims: Claims, name: str, file: h5py.File) -> Numbers:
    path, data = claims.path, file[name]
    plan = data.id.get_create_plist()
    if data.is_virtual or plan.get_layout() not in _LAYOUTS:
        raise _elsewhere(path, name, "is a virtual data set")
    if plan.get_external_count():
        raise _elsewhere(path, name, "has its values in another file")
    filters = [plan.get_filter(index)[0] for index in range(plan.get_nfilters())]
    if not set(filters) <= _FILTERS:
        raise RefusedError(
            f"{path}: {name} is stored through the HDF5 filters {filters}: write it with gzip or uncompressed"
        )
    if data.shape is None:
        raise RefusedError(f"{path}: {name} is a data set without values")
    if data.dtype.hasobject or data.dtype.metadata:
        raise RefusedError(
            f"{path}: {name} must be numbers, got references, text, lists or named values of HDF5"
        )
    size, kind = path.stat().st_size, data.dtype
    parts = _parts_of_complex(kind)
    dtype = kind if parts is None else np.dtype(f"c{parts.itemsize}")
    claims.add(name, dtype, data.shape, min(data.id.get_storage_size(), size))
    if data.chunks:  # HDF5 unpacks a chunk as a whole
        check_claim(path, f"a chunk of {name}", dtype, data.chunks, size)
    values = np.empty(data.shape, kind if parts is None else parts)
    if math.prod(data.shape):
        data.read_direct(values)
    return values if parts is None else values.view(dtype)


def _parts_of_complex(kind: np.dtype[np.void]) -> np.dtype[np.void] | None:
    """How real and imaginary part of MATLAB's complex numbers lie beside each other; None for others."""
    if kind.names != ("real", "imag"):
        return None
    real, imaginary = kind["real"], kind["imag"]
    if real != imaginary or real.kind != "f" or real.itemsize not in (4, 8):
        return None
    return np.dtype([(name, f"f{real.itemsize}") for name in kind.names])


def _elsewhere(path: Path, name: str, how: str) -> RefusedError:
    return RefusedError(
        f"{path}: {name} {how}, which is not followed, because it can lead to any file of this machine: copy "
        "the values into the file"
    )
