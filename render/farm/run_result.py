"""The result of a run, and how it is told to the user."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from disk.counted import counted
from render.farm.plan import Plan
from render.farm.run_log import LOG_FILE
from render.settings import RenderSettings
from scenegen import Dataset

_NUMBER = re.compile(r"[0-9]+(\.[0-9]+)?(e-?[0-9]+)?")
_NAMED = 10  # of scenes that share a reason


def failure_lines(failures: Mapping[str, str]) -> list[str]:
    """Reasons by scene as lines of text: a reason that scenes share, but for its numbers, is said once."""
    alike: dict[str, list[str]] = {}
    for scene_id, reason in sorted(failures.items()):
        alike.setdefault(_NUMBER.sub("#", reason), []).append(scene_id)
    lines = []
    for scenes in alike.values():
        first = f"scene {scenes[0]}: {failures[scenes[0]]}"
        others = f" ({len(scenes)} scenes: {', '.join(scenes[:_NAMED])}{', ...' * (len(scenes) > _NAMED)})"
        lines.append(f"failed: {first}{others if len(scenes) > 1 else ''}")
    return lines


@dataclass(frozen=True)
class RunResult:
    """The result of a run.

    Attributes
    ----------
    rendered : number of scenes that this run rendered.
    present : number of scenes that were rendered before, or by another command during the run.
    failures : reason of failure by scene.
    skipped_failures : number of scenes that failed in an earlier run and were not tried again.
    plan : of the scenes that were to be rendered; None if there were none.
    hidden_error_max : largest estimated error of the hidden signal, relative to it, over the rendered scenes
        of the dataset; None without an estimate.
    wanted_error : the error that was asked for; None if none was, as with ``--lights``.
    """

    rendered: int
    present: int
    failures: dict[str, str] = field(default_factory=dict)
    skipped_failures: int = 0
    plan: Plan | None = None
    hidden_error_max: float | None = None
    wanted_error: float | None = None

    def sentences(self, renders: Path) -> list[str]:
        """The result as lines of text; `renders` is the folder of the renders."""
        lines = [f"{counted(self.rendered, 'scene')} rendered, {self.present} were there already; {renders}"]
        largest, wanted = self.hidden_error_max, self.wanted_error
        if largest is not None and wanted is not None and largest > wanted:
            lines.append(
                f"the hidden signal has an estimated error of up to {largest:g}, but {wanted:g} was asked "
                "for: some scenes need more surface points than night-render takes, and "
                f"{renders / LOG_FILE} names them"
            )
        return lines

    def as_data(self, dataset: Dataset, settings: RenderSettings) -> dict[str, Any]:
        """The result as plain data (docs/reference/files.md, results as JSON)."""
        return {
            "renders": str(dataset.renders),
            "rendered": self.rendered,
            "present": self.present,
            "failed": len(self.failures),
            "skipped_failures": self.skipped_failures,
            "failures": self.failures,
            "settings": settings.as_data(dataset),
            "plan": self.plan.as_data() if self.plan is not None else None,
            "hidden_error_max": self.hidden_error_max,
        }

    def complaints(self, renders: Path) -> list[str]:
        """Failures and what to do about them, as lines of text; an empty list without failures."""
        lines = failure_lines(self.failures)
        if self.failures:
            lines.append(
                f"{counted(len(self.failures), 'scene')} failed; logs are in {renders}/<id>/failure.log, and "
                "night-render DATASET --again failed tries them again"
            )
        if self.skipped_failures:
            lines.append(
                f"left out: {counted(self.skipped_failures, 'scene')} that failed earlier; night-render "
                "status DATASET says which, night-render DATASET --again failed tries again"
            )
        return lines
