"""How far a dataset is rendered, read from its files without a scheduler."""

from __future__ import annotations

import shutil
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from statistics import median_low
from typing import Any

from disk.byte_size import size
from disk.counted import counted
from processes.progress import duration
from render.farm.claims import running
from render.farm.inventory import Inventory, State
from render.farm.run_result import failure_lines
from render.settings import RenderSettings
from scenegen import RECORD_FILE, Dataset, read_bad_render, read_failure, read_record

_LATEST = 200  # scenes that the pace is computed from
_LISTED = 10  # reasons of failures that are named, and defects
_PAUSE_S = 60.0  # a longer pause between scenes separates two runs


@dataclass(frozen=True)
class Status:
    """How far a dataset is rendered.

    Attributes
    ----------
    counts : scenes by state (`render.farm.inventory.State`).
    running : scenes that are being rendered now.
    failures : reason of failure by scene.
    defects : rendered scenes with the bytes that ``night-render verify`` found bad before, and what it found.
    edited : number of scenes, not rendered yet, whose files are not those of ``dataset.json``.
    used_bytes, free_bytes : size of the recorded files, and free space on the disk.
    scenes_per_hour : pace of the latest scenes; None if nothing is being rendered.
    """

    counts: Counter[State]
    running: list[str]
    failures: dict[str, str]
    defects: dict[str, str]
    edited: int
    used_bytes: int
    free_bytes: int
    scenes_per_hour: float | None

    @property
    def missing(self) -> int:
        """Number of scenes that are still to be rendered, including those being rendered now."""
        return self.counts["missing"] + self.counts["damaged"] + self.counts["other"]

    @property
    def seconds_left(self) -> float | None:
        """Time for the missing scenes at this pace; None if it is not known."""
        return 3600 * self.missing / self.scenes_per_hour if self.scenes_per_hour and self.missing else None

    def as_data(self) -> dict[str, Any]:
        """The status as plain data (docs/reference/files.md, results as JSON)."""
        return {
            "scenes": sum(self.counts.values()),
            "done": self.counts["done"],
            "failed": self.counts["failed"],
            "missing": self.missing,
            "damaged": self.counts["damaged"],
            "other_settings": self.counts["other"],
            "edited": self.edited,
            "running": self.running,
            "failures": self.failures,
            "defects": self.defects,
            "used_bytes": self.used_bytes,
            "free_bytes": self.free_bytes,
            "scenes_per_hour": self.scenes_per_hour,
            "seconds_left": self.seconds_left,
        }

    def sentences(self) -> list[str]:
        """The status as lines of text."""
        total = sum(self.counts.values())
        waiting = max(0, self.missing - len(self.running))
        parts = [
            f"{self.counts['done']} done",
            f"{len(self.running)} running",
            f"{self.counts['failed']} failed",
            f"{waiting} missing",
        ]
        lines = [f"{counted(total, 'scene')}: {', '.join(parts)}"]
        if self.counts["damaged"]:
            lines.append(f"{self.counts['damaged']} of the missing scenes are damaged")
        if self.counts["other"]:
            lines.append(f"{self.counts['other']} of the missing scenes are rendered with other settings")
        if self.edited:
            lines.append(
                f"{self.edited} of the scenes that are not done have other files than dataset.json lists: "
                "night-gen scenes repairs them"
            )
        lines.append(f"disk: {size(self.used_bytes)} used by renders, {size(self.free_bytes)} free")
        if self.seconds_left is not None:
            pace = f"pace: {self.scenes_per_hour:.0f} scenes an hour"
            lines.append(f"{pace}; about {duration(self.seconds_left)} left")
        failed = failure_lines(self.failures)
        lines += failed[:_LISTED]
        if len(failed) > _LISTED:
            lines.append(f"failed: for {len(failed) - _LISTED} more reasons")
        lines += [
            f"bad again: {scene_id}: it has the bytes that night-render verify found bad before"
            for scene_id in sorted(self.defects)[:_LISTED]
        ]
        return lines


def read_status(dataset: Dataset, settings: RenderSettings, scenes: Sequence[str]) -> Status:
    """Status of scenes of a dataset for `settings`."""
    inventory = Inventory(dataset, settings)
    states = inventory.states(scenes)
    failures, defects, used, times = {}, {}, 0, []
    for scene_id, state in states.items():
        folder = dataset.render_folder(scene_id)
        failure = read_failure(folder) if state == "failed" else None
        if failure is not None:
            failures[scene_id] = failure.reason
        record = read_record(folder)
        if record is None:
            continue
        bad = read_bad_render(folder) if state == "done" else None
        if bad is not None and bad.is_again(record):
            defects[scene_id] = "; ".join(bad.problems)
        used += sum(file.bytes for file in record.files.values())
        with suppress(FileNotFoundError):  # another command may be rendering it again
            times.append((folder / RECORD_FILE).stat().st_mtime)
    now_running = [scene_id for scene_id in running(dataset.renders) if scene_id in states]
    return Status(
        counts=Counter(states.values()),
        running=now_running,
        failures=failures,
        defects=defects,
        edited=sum(state != "done" and scene in inventory.edited for scene, state in states.items()),
        used_bytes=used,
        free_bytes=shutil.disk_usage(dataset.root).free,
        scenes_per_hour=_pace(times) if now_running else None,
    )


def _pace(times: list[float]) -> float | None:
    """Scenes per hour of the latest ones, up to now; scenes before a long pause do not count."""
    latest = sorted(times)[-_LATEST:]
    gaps = [after - before for before, after in pairwise(latest)]
    if not gaps:
        return None
    pauses = [index for index, gap in enumerate(gaps) if gap > _PAUSE_S + 10 * median_low(gaps)]
    if pauses:
        latest = latest[pauses[-1] + 1 :]
    span = time.time() - latest[0]
    return 3600 * (len(latest) - 1) / span if len(latest) > 1 and span > 0 else None
