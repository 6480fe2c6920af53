"""How a dataset is to be rendered, and what follows from that for each scene; no Mitsuba in it."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from typing import Any, Literal

from itof import TransientLayout
from render.backend import Device
from render.options import ManyLightOptions, MethodOptions, recipe_options, recorded_options
from scenegen import IMAGE_FILES, RENDERING_FILE, TRANSIENT_FILES, Dataset, NightError, RenderingRecord

Product = Literal["transient", "itof", "both"]
PRODUCTS: tuple[Product, ...] = ("transient", "itof", "both")
_MOST_PIXELS = 2**26  # all of an image's rays are in flight at once for the ground truth
_WORKING_COPIES = 4  # of a block of rows: bins, numpy's copy, a sum in double precision


class RenderError(NightError):
    """A scene that cannot be rendered as asked."""


@dataclass(frozen=True)
class RenderSettings:
    """How to render.

    Attributes
    ----------
    product : ``itof``: phasors and ground truth; ``transient`` or ``both``: transients as well.
    options : of the rendering method, which they name.
    max_bounces : surfaces that light may meet, instead of the preset's.
    device : auto, cpu or cuda.
    resolution : (width, height) instead of the preset's, with the same aspect ratio.
    """

    product: Product = "itof"
    options: MethodOptions = field(default_factory=ManyLightOptions)
    max_bounces: int | None = None
    device: Device = "auto"
    resolution: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.product not in PRODUCTS:
            raise RenderError(f"no product {self.product}: choose one of {', '.join(PRODUCTS)}")

    @property
    def method(self) -> str:
        """Name of the rendering method."""
        return self.options.method

    @property
    def wants_transients(self) -> bool:
        """Whether time-resolved files are written."""
        return self.product != "itof"

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that a scene's render folder must hold."""
        return (*TRANSIENT_FILES, *IMAGE_FILES) if self.wants_transients else IMAGE_FILES

    def layout(self, dataset: Dataset) -> TransientLayout:
        """Image size and time axis of a dataset rendered so.

        Raises
        ------
        RenderError : a resolution of another aspect ratio than the camera's, an image that is too large, or
            a time axis of which not one image row fits into memory.
        """
        camera, axis = dataset.preset.camera, dataset.preset.transient
        width, height = self.resolution or (camera.width, camera.height)
        if width < 1 or height < 1 or width * camera.height != height * camera.width:
            raise RenderError(
                f"a resolution of {width}x{height} has not the aspect ratio of the camera and its projector "
                f"({camera.width}x{camera.height}): choose a multiple or a fraction of that"
            )
        if width * height > _MOST_PIXELS:
            raise RenderError(
                f"an image of {width}x{height} pixels is too large: at most {_MOST_PIXELS} pixels"
            )
        layout = TransientLayout(width, height, axis.bin_count, axis.bin_width_m, axis.start_opl_m)
        if self.wants_transients:
            _check_memory(layout)
        return layout

    def bounces(self, dataset: Dataset) -> int:
        """Surfaces that light may meet."""
        return self.max_bounces or dataset.preset.transient.max_bounces

    def recipe(self, dataset: Dataset, scene_id: str) -> str:
        """All that a scene's pixels depend on, as JSON; a render of the same recipe need not be made again.

        But for rounding: device and program versions are provenance, not recipe.

        Raises
        ------
        RenderError : there is no such scene folder.
        """
        return json.dumps({**self.common_recipe(dataset), "scene_sha256": scene_sha256(dataset, scene_id)})

    def common_recipe(self, dataset: Dataset) -> dict[str, Any]:
        """The part of a recipe that all scenes of a dataset share."""
        layout = self.layout(dataset)
        return {
            "method": self.method,
            "options": recipe_options(self.options),
            "max_bounces": self.bounces(dataset),
            "size": [layout.width, layout.height],
            "bins": [layout.bin_count, layout.bin_width_m, layout.start_opl_m],
            "frequencies_hz": list(dataset.preset.itof.frequencies_hz),
        }


def scene_sha256(dataset: Dataset, scene_id: str) -> str:
    """SHA-256 of all files that describe a scene; `RenderError` when there are none."""
    digest = hashlib.sha256()
    files = sorted(dataset.scene_folder(scene_id).glob("*"))
    if not files:
        raise RenderError(f"{dataset.scene_folder(scene_id)} is missing or empty: run night-gen scenes again")
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def read_recipe(recipe: str) -> dict[str, Any]:
    """Contents of a recipe; empty when it is none."""
    try:
        content = json.loads(recipe)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def settings_of(rendering: RenderingRecord, dataset: Dataset) -> RenderSettings:
    """The settings that a dataset was rendered with, from its record.

    Raises
    ------
    RenderError : a method, product or option that this version does not know.
    """
    camera = dataset.preset.camera
    size = (rendering.width, rendering.height)
    bounces = rendering.max_bounces
    try:
        return RenderSettings(
            product=rendering.product,  # type: ignore[arg-type]
            options=recorded_options(rendering.method, rendering.options),
            max_bounces=None if bounces == dataset.preset.transient.max_bounces else bounces,
            resolution=None if size == (camera.width, camera.height) else size,
        )
    except (TypeError, ValueError) as error:
        raise RenderError(
            f"{dataset.renders / RENDERING_FILE} cannot be used ({error}): delete it and give the settings "
            "anew"
        ) from None


def _check_memory(layout: TransientLayout) -> None:
    """Refuse a time axis of which not even one image row fits, before rendering starts."""
    needed = _WORKING_COPIES * 4 * layout.width * layout.bin_count
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > memory or layout.width * layout.bin_count >= 2**31:
        raise RenderError(
            f"one image row of {layout.width} pixels x {layout.bin_count} bins needs {needed / 1e9:.2g} GB "
            f"of this machine's {memory / 1e9:.2g} GB: use fewer bins, fewer pixels, or --product itof"
        )
