"""The light of scenes of a dataset, with the user's meshes from their own folders.

The light of a scene depends on its own files alone. So a scene with meshes is rendered alone: the place of a
mesh beside others decides how its rays are rounded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from render.backend import Device
from render.batch.light import BatchedLight, SceneLight
from scenegen.mitsuba_description import hidden_names
from scenegen.scene import Scene
from scenegen.shapes import MESH_PREFIX, PRIMITIVES, Shape
from scenegen.triangles import MeshError
from scenegen.unit_meshes import UnitMesh, unit_mesh_of_part

Files = Mapping[str, bytes]  # contents of a scene's folder, by name


class SceneLights:
    """Renders scenes as `BatchedLight` does, whose parameters these are."""

    def __init__(
        self, frequencies_hz: Sequence[float], width: int, height: int, *, error: float, device: Device
    ) -> None:
        self._frequencies_hz, self._size = frequencies_hz, (width, height)
        self.error, self._device = error, device
        self._without_meshes: BatchedLight | None = None

    def of(self, scenes: Sequence[tuple[Scene, Files]]) -> dict[str, SceneLight]:
        """The light of each scene, by its id; scenes with a damaged mesh have none."""
        found: dict[str, SceneLight] = {}
        for batch, meshes in _batches(scenes):
            images = self._engine(meshes).images(batch)
            found |= {scene.id: images.of(place) for place, scene in enumerate(batch)}
        return found

    def _engine(self, meshes: Mapping[Shape, UnitMesh]) -> BatchedLight:
        if not meshes and self._without_meshes is not None:
            return self._without_meshes
        engine = BatchedLight(
            self._frequencies_hz, *self._size, error=self.error, meshes=meshes, device=self._device
        )
        if not meshes:
            self._without_meshes = engine
        return engine


def _batches(
    scenes: Sequence[tuple[Scene, Files]],
) -> Iterator[tuple[list[Scene], dict[Shape, UnitMesh]]]:
    """Scenes to render at once, and their meshes."""
    without: list[Scene] = []
    for scene, files in scenes:
        try:
            scene, meshes = _with_own_meshes(scene, files)
        except MeshError:
            continue
        if meshes:
            yield [scene], meshes
        else:
            without.append(scene)
    if without:
        yield without, {}


def _with_own_meshes(scene: Scene, files: Files) -> tuple[Scene, dict[Shape, UnitMesh]]:
    """The scene with a shape of its own for each mesh of the user, and these unit meshes."""
    parts, meshes = [], {}
    for part, name in zip(scene.hidden_objects, hidden_names(scene), strict=True):
        if part.shape not in PRIMITIVES:
            file = f"{name}.ply"
            mesh = unit_mesh_of_part(part, files.get(file, b""), f"{scene.id}/{file}")
            part = replace(part, shape=f"{MESH_PREFIX}{scene.id}/{file}")
            meshes[part.shape] = mesh
        parts.append(part)
    return replace(scene, hidden_objects=tuple(parts)), meshes
