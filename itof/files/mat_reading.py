"""Arrays of a MATLAB file of version 5, whose headers are read before its values.

A file of version 7.3 is an HDF5 file with another beginning. Of the kinds of MATLAB's variables, only arrays
of numbers are read, also as fields of a structure: no objects, cells, functions, texts and sparse arrays.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from itof.arrays import Numbers
from itof.files.array_claims import Claims, RefusedError

_HDF5 = b"\x89HDF\r\n\x1a\n"
_BLOCK = 512  # bytes that MATLAB writes before the HDF5 file
_KINDS: Final = {  # of MATLAB's numbers
    "double": "f8",
    "single": "f4",
    "logical": "u1",
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("u", "") for size in (1, 2, 4, 8)},
}


def is_hdf5(path: Path) -> bool:
    """Whether a MATLAB file is one of version 7.3."""
    with path.open("rb") as stream:
        start = stream.read(_BLOCK + len(_HDF5))
    return start.startswith(_HDF5) or start[_BLOCK:] == _HDF5


def read_mat(path: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Numbers], list[str]]:
    """The arrays among `wanted` that a file has, and the names of all its variables.

    Raises
    ------
    RefusedError : it is no MATLAB file, is damaged, an array is not one of numbers, or claims too much.
    """
    from scipy.io import loadmat, whosmat

    try:
        listed = whosmat(path)
        claims = Claims(path)
        here = {name: kind for name, _, kind in listed if name in wanted}
        fields = _fields(wanted, [name for name, _, kind in listed if kind == "struct"])
        outside = {name.split(".")[0] for name in fields}
        for name, shape, kind in listed:
            if name in wanted:
                _check(claims, name, kind, tuple(shape))
            if name in outside:
                _refuse_many(path, name, math.prod(shape))  # a header can claim any number of them
        outer = [*here, *outside]
        read = loadmat(path, variable_names=outer, struct_as_record=True) if outer else {}
        found = {name: _of_kind(read[name], kind) for name, kind in here.items()}
        found |= {name: values for name in fields if (values := _field(path, read, name)) is not None}
        claims = Claims(path)  # complex numbers take twice what the list of variables says
        for name, values in found.items():
            claims.add(name, values.dtype, values.shape, values.nbytes)
    except (RefusedError, MemoryError):
        raise
    except Exception as error:  # of any kind: scipy's reader of such files raises many
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RefusedError(f"{path} cannot be read: it is damaged or no MATLAB file ({reason})") from None
    structures = {name: read[name].dtype.names for name in outer if read[name].dtype.names}
    names = [[f"{name}.{field}" for field in structures.get(name, ())] or [name] for name, _, _ in listed]
    return found, [each for group in names for each in group]


def _fields(wanted: tuple[str, ...], structures: list[str]) -> list[str]:
    """The names among `wanted` that are fields, such as ``data.raw``, of these structures."""
    return [name for name in wanted if "." in name and name.split(".")[0] in structures]


def _field(path: Path, read: dict[str, Any], name: str) -> Numbers | None:
    """The numbers of a field of structures of one element each; None if there is no such field."""
    outer, *inner = name.split(".")
    values = read[outer]
    for part in inner:
        if values.dtype.names is None or part not in values.dtype.names:
            return None
        _refuse_many(path, name, values.size)
        values = values[part].item()
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "iufc":
        raise RefusedError(f"{path}: {name} is no array of numbers: save it as one")
    return values


def _refuse_many(path: Path, name: str, count: int) -> None:
    if count != 1:
        raise RefusedError(
            f"{path}: {name} has {count} structures, whose fields are not read: save them as arrays of "
            "numbers"
        )


def _of_kind(values: Numbers, kind: str) -> Numbers:
    """Numbers in the type of their variable: MATLAB stores whole numbers in fewer bytes.

    scipy can restore the type too (`mat_dtype`), but drops imaginary parts then.
    """
    dtype = np.dtype(_KINDS[kind])
    if values.dtype.kind == "c":
        dtype = np.dtype(np.complex64 if kind == "single" else np.complex128)
    return np.asarray(values, dtype)


def _check(claims: Claims, name: str, kind: str, shape: tuple[int, ...]) -> None:
    path = claims.path
    if kind not in _KINDS:
        raise RefusedError(
            f"{path}: {name} is a MATLAB variable of the kind {kind}, which is not read: save it as an array "
            "of numbers"
        )
    if any(side < 0 for side in shape):
        raise RefusedError(f"{path}: {name} has the shape {shape}: the file is damaged; write it again")
    claims.add(name, np.dtype(_KINDS[kind]), shape, path.stat().st_size)
