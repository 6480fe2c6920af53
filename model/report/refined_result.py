"""Results of refined scenes: metrics before and after, and the solids that were found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pydantic.dataclasses import dataclass as checked_dataclass

from model.network.metrics import ImageMetrics, summarise
from scenegen.contract import STRICT, Vector


@checked_dataclass(frozen=True, config=STRICT)
class FoundSolid:
    """A fitted solid in world axes, as ``scene.json`` describes hidden objects."""

    shape: str
    size_m: Vector
    location_m: Vector
    rotation_deg: Vector


@checked_dataclass(frozen=True, config=STRICT)
class SceneNumbers:
    """Metrics of one depth map of a scene (`ImageMetrics`)."""

    depth_mae_m: float
    object_mae_m: float | None
    object_iou: float
    background_iou: float

    def metrics(self) -> ImageMetrics:
        """The same as metrics of an image."""
        return ImageMetrics(self.depth_mae_m, self.object_mae_m, self.object_iou, self.background_iou)


@checked_dataclass(frozen=True, config=STRICT)
class RefinedScene:
    """Result of one scene.

    Attributes
    ----------
    network, refined : metrics of the network's depth map and of the refined one, which is the network's where
        the fit is not accepted.
    solid : the fitted solid, accepted or not; None if the network sees no object.
    misfit : part of the hidden light that the solid does not explain.
    reflectance, roughness : of the solid and of the relay wall, fitted or known.
    """

    scene: str
    object_class: str
    network: SceneNumbers
    refined: SceneNumbers
    accepted: bool
    misfit: float | None
    solid: FoundSolid | None
    reflectance: float | None
    roughness: float | None


@dataclass(frozen=True)
class RefinementReport:
    """Results of all scenes of a split."""

    scenes: tuple[RefinedScene, ...]

    @property
    def table(self) -> str:
        """Network and refined depth maps, of all scenes and of each class; ± are standard errors."""
        rows = [
            "| scenes | | network: MAE cm | mIoU | object MAE cm | refined: MAE cm | mIoU | object MAE cm |"
        ]
        rows.append("|---|---|---|---|---|---|---|---|")
        classes = sorted({scene.object_class for scene in self.scenes})
        groups = [("all", list(self.scenes))]
        groups += [(name, [s for s in self.scenes if s.object_class == name]) for name in classes]
        for name, scenes in groups:
            before, after = ([getattr(s, part).metrics() for s in scenes] for part in ("network", "refined"))
            cells = [*_cells(before), *_cells(after)]
            rows.append(f"| {name.replace('_', ' ')} | {len(scenes)} | {' | '.join(cells)} |")
        return "\n".join(rows)

    @property
    def sentence(self) -> str:
        """How many fits were accepted."""
        accepted = sum(scene.accepted for scene in self.scenes)
        return f"{accepted} of {len(self.scenes)} scenes are explained by a solid; the others stay"

    def as_data(self) -> dict[str, Any]:
        """All numbers as plain data."""
        before, after = ([getattr(s, part).metrics() for s in self.scenes] for part in ("network", "refined"))
        return {
            "schema_version": 1,
            "scene_count": len(self.scenes),
            "accepted_count": sum(scene.accepted for scene in self.scenes),
            "network": asdict(summarise(before)),
            "refined": asdict(summarise(after)),
            "scenes": [asdict(scene) for scene in self.scenes],
        }


def _cells(metrics: Sequence[ImageMetrics]) -> tuple[str, str, str]:
    """MAE, mIoU and object MAE with their standard errors."""
    found = summarise(metrics)
    cells = []
    for statistics, factor, digits in (
        (found.depth_mae_m, 100, 2),
        (found.miou, 1, 3),
        (found.object_mae_m, 100, 2),
    ):
        if statistics is None:
            cells.append("-")
            continue
        error = statistics.std / math.sqrt(statistics.count)
        cells.append(f"{factor * statistics.mean:.{digits}f} ± {factor * error:.{digits}f}")
    return cells[0], cells[1], cells[2]
