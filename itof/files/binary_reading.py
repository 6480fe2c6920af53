"""Arrays of a file of bare numbers whose layout is told: records of fields, to the end of the file."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from itof.arrays import Numbers
from itof.files.array_claims import Claims, RefusedError

_FIELD: Final = re.compile(
    r"(?P<name>\w{1,100}) (?P<type>[<>]?([ui][124]|f[48])|u12)"
    r"( (?P<sides>\d{1,7}(x\d{1,7}){0,4}))?( stride (?P<stride>\d{1,9}))?"
)
_PACKED: Final = "u12"  # two numbers in three bytes, as MIPI RAW12


class BinaryField(NamedTuple):
    """A field of a record.

    Attributes
    ----------
    type : of its numbers, as numpy names it, or ``u12``.
    sides : of its array; empty for one number.
    stride : bytes from the beginning of a row, the last axis, to that of the next.
    """

    name: str
    type: str
    sides: tuple[int, ...]
    stride: int

    @property
    def row_bytes(self) -> int:
        """Bytes of the numbers of a row."""
        count = self.sides[-1] if self.sides else 1
        return count * 3 // 2 if self.type == _PACKED else count * np.dtype(self.type).itemsize

    @property
    def size(self) -> int:
        """Bytes of the field."""
        return math.prod(self.sides[:-1]) * self.stride


class BinaryLayout(NamedTuple):
    """Fields of a record, records of a frame along each axis, and bytes before the first record."""

    fields: Sequence[str]
    shape: Sequence[int]
    header: int


def fields_of(texts: Sequence[str]) -> tuple[BinaryField, ...]:
    """The fields of texts ``NAME TYPE [SIDExSIDE] [stride BYTES]``.

    TYPE is ``u1``, ``u2``, ``u4``, ``i1``, ``i2``, ``i4``, ``f4`` or ``f8``, with ``>`` before it if the
    highest byte comes first; or ``u12``, two numbers in three bytes as MIPI RAW12 packs them.

    Raises
    ------
    ValueError : a text is no field, or its rows do not fit its stride.
    """
    found = [_field(text) for text in texts]
    if len({field.name for field in found}) < len(found):
        raise ValueError("binary.fields names a field twice")
    return tuple(found)


def _field(text: str) -> BinaryField:
    match = _FIELD.fullmatch(text)
    if match is None:
        raise ValueError(
            f"binary.fields has {text!r}, which is no field like 'raw u2 240x320': a name, one of u1, u2, "
            "u4, i1, i2, i4, f4, f8, u12, the sides, and stride with the bytes of a row"
        )
    sides = tuple(int(side) for side in (match["sides"] or "").split("x") if side)
    kind = match["type"] if match["type"] == _PACKED else np.dtype(f"<{match['type']}".replace("<>", ">")).str
    field = BinaryField(match["name"], kind, sides, 0)
    if 0 in sides or (kind == _PACKED and (not sides or sides[-1] % 2)):
        raise ValueError(f"binary.fields has {text!r}: sides are above 0, and rows of u12 are pairs")
    stride = int(match["stride"] or field.row_bytes)
    if stride < field.row_bytes:
        raise ValueError(f"binary.fields has {text!r}, and a row has {field.row_bytes} bytes")
    return field._replace(stride=stride)


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
            dtype = np.dtype(np.uint16 if field.type == _PACKED else field.type)
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
    if kind != _PACKED:
        return np.ascontiguousarray(rows).view(kind)
    first, second, low = (rows[:, place::3].astype(np.uint16) for place in range(3))
    return np.stack([first << 4 | low & 15, second << 4 | low >> 4], axis=-1)
