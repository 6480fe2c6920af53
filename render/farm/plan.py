"""Disk space that a run needs: measured on rendered scenes if there are any, else estimated."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from disk.byte_size import size
from disk.counted import counted
from itof import TransientLayout
from render.settings import RenderSettings
from scenegen import IMAGE_FILES, TRANSIENT_FILES, Dataset, read_record

_TRUTH_CHANNELS = 4  # of the ground truth: depth, mask, Re, Im
_COMPONENTS = 2  # Re and Im
_FLOAT_BYTES = 4
_MEASURED_SCENES = 20  # give the mean size well enough
_MARGIN = 1.05
_HIDDEN_BOUNCES = 3  # wall, object, wall


@dataclass(frozen=True)
class Plan:
    """Disk space that some scenes need, and that is free.

    Attributes
    ----------
    scenes : number of scenes to render.
    image_bytes, transient_bytes : size of one scene.
    free_bytes : free space on the disk of the dataset.
    """

    dataset: Dataset
    settings: RenderSettings
    scenes: int
    image_bytes: int
    transient_bytes: int
    free_bytes: int

    @property
    def scene_bytes(self) -> int:
        """Bytes of one scene with the requested product."""
        return self.image_bytes + (self.transient_bytes if self.settings.wants_transients else 0)

    @property
    def needed_bytes(self) -> int:
        """Bytes of all scenes to be rendered, 5 % more than the estimate."""
        return int(_MARGIN * self.scenes * self.scene_bytes)

    def sentences(self) -> list[str]:
        """The plan as lines of text."""
        layout = self.settings.layout(self.dataset)
        images, transients = (size(self.scenes * each) for each in (self.image_bytes, self.transient_bytes))
        space = f"phasors and ground truth {images}, transients {transients}"
        if not self.settings.wants_transients:
            space = f"phasors and ground truth {images} (transients would be {transients} more)"
        what = f"{counted(self.scenes, 'scene')} at {layout.width}x{layout.height}, {self.settings.method}"
        lines = [
            f"plan: {what}, product {self.settings.product}",
            f"disk: {space}; {size(self.scene_bytes)} a scene, {size(self.free_bytes)} free",
        ]
        if (bounces := self.settings.bounces(self.dataset)) < _HIDDEN_BOUNCES:
            lines.append(
                f"warning: with at most {bounces} bounces, no light of the hidden object reaches the camera, "
                f"which takes {_HIDDEN_BOUNCES}: give --max-bounces {_HIDDEN_BOUNCES} or more"
            )
        return lines

    def as_data(self) -> dict[str, Any]:
        """The plan as plain data: the scenes to render, and bytes."""
        return {
            "scenes": self.scenes,
            "image_bytes_per_scene": self.image_bytes,
            "transient_bytes_per_scene": self.transient_bytes if self.settings.wants_transients else 0,
            "needed_bytes": self.needed_bytes,
            "free_bytes": self.free_bytes,
        }

    def refusal(self) -> str | None:
        """A message if the plan does not fit the disk, with proposals that do; None if it fits."""
        if self.needed_bytes <= self.free_bytes:
            return None
        proposals = []
        small = replace(self, settings=replace(self.settings, product="itof"))
        if self.settings.wants_transients and small.needed_bytes <= self.free_bytes:
            proposals.append(f"--product itof needs {size(small.needed_bytes)}")
        resolution = self._fitting_resolution()
        if resolution is not None:
            proposals.append(f"--resolution {resolution} fits")
        fitting = int(self.free_bytes / (_MARGIN * self.scene_bytes))
        if fitting > 0:
            proposals.append(f"there is room for {counted(fitting, 'scene')}")
        advice = "; ".join([*proposals, "--accept small-disk renders until the disk is full"])
        return (
            f"the disk of {self.dataset.root} has {size(self.free_bytes)} free, and "
            f"{counted(self.scenes, 'scene')} would take about {size(self.needed_bytes)}: {advice}"
        )

    def _fitting_resolution(self) -> str | None:
        """The largest image size that fits, of the size divided by 2, 4, 8, ...; None if none fits."""
        layout = self.settings.layout(self.dataset)
        width, height = layout.width, layout.height
        share = 1
        while width % 2 == 0 and height % 2 == 0:
            width, height, share = width // 2, height // 2, share * 4
            if self.needed_bytes / share <= self.free_bytes:
                return f"{width}x{height}"
        return None


def make_plan(dataset: Dataset, settings: RenderSettings, todo: Sequence[str], done: Sequence[str]) -> Plan:
    """The plan of rendering the scenes `todo`, with sizes from the scenes `done` if there are any."""
    layout = settings.layout(dataset)
    measured = [_measured(dataset, scene_id) for scene_id in done[:_MEASURED_SCENES]]
    images = [sizes[0] for sizes in measured if sizes[0]]
    transients = [sizes[1] for sizes in measured if sizes[1]]
    return Plan(
        dataset,
        settings,
        len(todo),
        image_bytes=sum(images) // len(images) if images else _image_bytes(dataset, settings, layout),
        transient_bytes=(
            sum(transients) // len(transients) if transients else _transient_bytes(settings, layout)
        ),
        free_bytes=shutil.disk_usage(dataset.root).free,
    )


def _measured(dataset: Dataset, scene_id: str) -> tuple[int, int]:
    """Bytes of the images and of the transients of a rendered scene, from its record."""
    record = read_record(dataset.render_folder(scene_id))
    files = record.files if record is not None else {}
    images, transients = (
        sum(files[name].bytes for name in names if name in files) for names in (IMAGE_FILES, TRANSIENT_FILES)
    )
    return images, transients


def _image_bytes(dataset: Dataset, settings: RenderSettings, layout: TransientLayout) -> int:
    parts = settings.options.phasor_parts
    channels = parts * _COMPONENTS * len(dataset.preset.itof.frequencies_hz) + _TRUTH_CHANNELS
    return _FLOAT_BYTES * layout.width * layout.height * channels  # phasors do not compress


def _transient_bytes(settings: RenderSettings, layout: TransientLayout) -> int:
    return int(settings.options.transient_fill * len(TRANSIENT_FILES) * layout.raw_bytes)
