"""Arrays of a MATLAB file of version 5, whose headers are read before its values.

A file of version 7.3 is an HDF5 file with another beginning. Of the kinds of MATLAB's variables, only arrays
of numbers are read: no objects, structures, cells, functions, texts and sparse arrays.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

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
        for name, shape, kind in listed:
            if name in wanted:
                _check(claims, name, kind, tuple(shape))
        found = loadmat(path, variable_names=list(here), struct_as_record=True) if here else {}
        found = {name: _of_kind(found[name], kind) for name, kind in here.items()}
        claims = Claims(path)  # complex numbers take twice what the list of variables says
        for name, values in found.items():
            claims.add(name, values.dtype, values.shape, values.nbytes)
    except (RefusedError, MemoryError):
        raise
    except Exception as error:  # of any kind: scipy's reader of such files raises many
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RefusedError(f"{path} cannot be read: it is damaged or no MATLAB file ({reason})") from None
    return found, [name for name, _, _ in listed]


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
