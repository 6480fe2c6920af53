"""Arrays of a file of bare numbers: records of fields, to the end of the file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from itof.arrays import Numbers
from itof.binary_fields import PACKED, BinaryLayout, fields_of
from itof.files.array_claims import Claims, RefusedError


def read_binary(
    path: Path, layout: BinaryLayout, wanted: tuple[str, ...]
) -> tuple[dict[str, Numbers], list[str]]:
    """The fields among `wanted` as arrays (frame, shape, sides), and the names of all fields.

    Raises
    ------
    RefusedError : the file does not end with a frame, or does not fit into the memory.
    """
    fields = fields_of(layout.fields)
    size, record = path.stat().st_size - layout.header, sum(field.size for field in fields)
    frame = record * math.prod(layout.shape)
    if size < frame or size % frame:
        raise RefusedError(
            f"{path} has {max(size, 0)} bytes after a header of {layout.header}, which are no whole number "
            f"of frames of {frame} bytes: correct the table binary of the sidecar"
        )
    claims = Claims(path)
    claims.add("the whole file", np.dtype(np.uint8), (size,), size)
    with path.open("rb") as stream:
        stream.seek(layout.header)
        records = np.frombuffer(stream.read(size), np.uint8)
    if records.size != size:
        raise RefusedError(f"{path} became shorter while it was read: try again")
    found, at = {}, 0
    for field in fields:
        if field.name in wanted:
            shape = (size // frame, *layout.shape, *field.sides)
            dtype = np.dtype(np.uint16 if field.type == PACKED else field.type)
            claims.add(field.name, dtype, shape, size)
            part = records.reshape(-1, record)[:, at : at + field.size]
            rows = part.reshape(-1, field.stride)[:, : field.row_bytes]
            found[field.name] = _numbers(rows, field.type).reshape(shape)
        at += field.size
    return found, [field.name for field in fields]


def _numbers(rows: NDArray[np.uint8], kind: str) -> Numbers:
    """The numbers of rows of bytes.

    Source of the packing: Linux kernel, V4L2_PIX_FMT_Y12P: two bytes with the high 8 bits of two numbers,
    then one whose lower half has the low bits of the first.
    """
    if kind != PACKED:
        return np.ascontiguousarray(rows).view(kind)
    first, second, low = (rows[:, place::3].astype(np.uint16) for place in range(3))
    return np.stack([first << 4 | low & 15, second << 4 | low >> 4], axis=-1)
