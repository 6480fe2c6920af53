"""The user's meshes of scenes, from their own files: what the engine renders depends on one scene alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from scenegen.mitsuba_description import hidden_names
from scenegen.pose import rotation_matrix
from scenegen.scene import Scene
from scenegen.shapes import MESH_PREFIX, PRIMITIVES, Shape
from scenegen.triangles import read_triangles
from scenegen.unit_meshes import UnitMesh


def with_own_meshes(scene: Scene, files: Mapping[str, bytes]) -> tuple[Scene, dict[Shape, UnitMesh]]:
    """The scene with a shape of its own for each mesh of the user, and these unit meshes.

    Parameters
    ----------
    files : contents of the scene's folder, by name.

    Raises
    ------
    MeshError : a mesh file is damaged.
    """
    parts, meshes = [], {}
    for part, name in zip(scene.hidden_objects, hidden_names(scene), strict=True):
        if part.shape not in PRIMITIVES:
            file = f"{name}.ply"
            vertices, triangles = read_triangles(files.get(file, b""), "ply", f"{scene.id}/{file}")
            unit = (vertices - part.location_m) @ rotation_matrix(part.rotation_deg) / part.size_m
            part = replace(part, shape=f"{MESH_PREFIX}{scene.id}/{file}")
            meshes[part.shape] = UnitMesh(
                unit.astype(np.float32), triangles.astype(np.int32), np.arange(len(unit))
            )
        parts.append(part)
    return replace(scene, hidden_objects=tuple(parts)), meshes
