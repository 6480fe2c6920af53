"""Which shapes a hidden object can have: the primitives, or a mesh file of the user."""

from __future__ import annotations

from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated

from pydantic import AfterValidator

PRIMITIVES = ("cube", "cylinder", "sphere", "cone", "concave_plane", "parallelepiped")
MESH_PREFIX = "mesh:"  # followed by the path of a mesh file, relative to the preset's folder


def known_shape(shape: str) -> str:
    """The shape, if it is one; `ValueError` says why it is none."""
    if shape in PRIMITIVES:
        return shape
    if not shape.startswith(MESH_PREFIX):
        raise ValueError(f'no such shape: give {", ".join(PRIMITIVES)} or "{MESH_PREFIX}FILE"')
    file = shape.removeprefix(MESH_PREFIX)
    if not file.isprintable() or not file.strip():
        raise ValueError(f'"{MESH_PREFIX}" must be followed by the name of a mesh file')
    if PurePosixPath(file).is_absolute() or PureWindowsPath(file).is_absolute():
        raise ValueError(
            "a mesh file is named relative to the preset's own folder, so that others find it too"
        )
    return shape


Shape = Annotated[str, AfterValidator(known_shape)]  # one of PRIMITIVES, or "mesh:FILE"
