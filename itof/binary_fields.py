"""How bare numbers lie in a file: records of fields, as somebody tells it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

_FIELD: Final = re.compile(
    r"(?P<name>\w{1,100}) (?P<type>[<>]?([ui][124]|f[48])|u12)"
    r"( (?P<sides>\d{1,7}(x\d{1,7}){0,4}))?( stride (?P<stride>\d{1,9}))?"
)
PACKED: Final = "u12"  # two numbers in three bytes, as MIPI RAW12


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
        return count * 3 // 2 if self.type == PACKED else count * np.dtype(self.type).itemsize

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
    order = "" if match["type"][0] in "<>" else "<"
    kind = match["type"] if match["type"] == PACKED else np.dtype(order + match["type"]).str
    field = BinaryField(match["name"], kind, sides, 0)
    if 0 in sides or (kind == PACKED and (not sides or sides[-1] % 2)):
        raise ValueError(f"binary.fields has {text!r}: sides are above 0, and rows of u12 are pairs")
    stride = int(match["stride"] or field.row_bytes)
    if stride < field.row_bytes:
        raise ValueError(f"binary.fields has {text!r}, and a row has {field.row_bytes} bytes")
    return field._replace(stride=stride)
