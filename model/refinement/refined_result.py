"""Results of refined scenes: metrics before and after, and the solids that were found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from pydantic.dataclasses import dataclass as checked_dataclass

from disk.contract import STRICT
from itof.metrics import ImageMetrics, summarise, summary_cells
from model.prediction.explanation import Explanation

_UNEXPLAINED = 0.2  # of the light, by most solids


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
    expected_mae_m : error that the network expects of its depth map, metres; None without probabilities.
    found : what explains the light, accepted or not; None if the network sees no object.
    """

    scene: str
    object_class: str
    network: SceneNumbers
    refined: SceneNumbers
    expected_mae_m: float | None
    found: Explanation | None

    @property
    def accepted(self) -> bool:
        """Whether the refined depth map is that of the solids."""
        return self.found is not None and self.found.accepted


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
            cells = [*summary_cells(summarise(before)), *summary_cells(summarise(after))]
            words = name.replace("_", " ").replace("|", "\\|")
            rows.append(f"| {words} | {len(scenes)} | {' | '.join(cells)} |")
        return "\n".join(rows)

    @property
    def sentence(self) -> str:
        """How many fits were accepted, and whether the corner may be another one."""
        accepted = sum(scene.accepted for scene in self.scenes)
        said = f"{accepted} of {len(self.scenes)} solids are accepted; the other depth maps are the network's"
        misfits = [scene.found.misfit for scene in self.scenes if scene.found is not None]
        if misfits and (usual := median(misfits)) > _UNEXPLAINED:
            said += f"; solids leave {usual:.0%} of the light: is the middle wall where the dataset has it?"
        return said

    def as_data(self) -> dict[str, Any]:
        """All numbers as plain data."""
        before, after = ([getattr(s, part).metrics() for s in self.scenes] for part in ("network", "refined"))
        return {
            "schema_version": 4,
            "scene_count": len(self.scenes),
            "accepted_count": sum(scene.accepted for scene in self.scenes),
            "network": asdict(summarise(before)),
            "refined": asdict(summarise(after)),
            "scenes": [asdict(scene) for scene in self.scenes],
        }
