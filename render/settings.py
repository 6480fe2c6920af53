"""How a dataset is rendered, and what follows from that for each scene. Does not import Mitsuba."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from disk import NightError
from disk.machine_memory import machine_bytes
from itof import MOST_WRITTEN_BYTES, TransientLayout
from render.backend import Device
from render.options import (
    FINEST_EDGES,
    BatchedOptions,
    ManyLightOptions,
    MethodOptions,
    option_names,
    options_of,
    recipe_options,
    recorded_options,
)
from scenegen import IMAGE_FILES, RENDERING_FILE, TRANSIENT_FILES, Dataset, RenderingRecord, read_recipe
from scenegen.preset import MOST_BOUNCES

Product = Literal["transient", "itof", "both"]
EDGES_KEY = "edge_divisions"  # of a recipe
PRODUCTS: tuple[Product, ...] = ("transient", "itof", "both")
_MOST_SCENES, _PIXELS_AT_ONCE = 64, 2**20  # of the batched engine
_MOST_PIXELS = 2**26  # the ground truth traces the rays of all pixels at once
# Copies of a row block in memory, as float32: bins and sum in float64, which count twice, and two in float32.
_WORKING_COPIES = 6


class RenderError(NightError):
    """A scene cannot be rendered with the requested settings, or a render cannot be used."""


@dataclass(frozen=True)
class RenderSettings:
    """How to render the scenes of a dataset.

    Attributes
    ----------
    product : ``itof`` is phasors and ground truth; ``transient`` and ``both`` are transients as well.
    options : options of the rendering method; their class selects the method.
    max_bounces : most surfaces that light may meet; None takes the preset's number.
    device : ``auto``, ``cpu`` or ``cuda``.
    resolution : (width, height) in pixels, with the camera's aspect ratio; None takes the preset's size.
    accept_edited : whether to render scenes whose files are not those that ``dataset.json`` vouches for.

    accept_lost_light : whether to write transients that lack hidden light from outside the time axis.

    Raises
    ------
    RenderError : an unknown product, or a number of bounces that cannot be rendered.
    """

    product: Product = "itof"
    options: MethodOptions = field(default_factory=ManyLightOptions)
    max_bounces: int | None = None
    device: Device = "auto"
    resolution: tuple[int, int] | None = None
    accept_edited: bool = False
    accept_lost_light: bool = False

    def __post_init__(self) -> None:
        if self.product not in PRODUCTS:
            raise RenderError(f"unknown product {self.product}: choose one of {', '.join(PRODUCTS)}")
        if self.max_bounces is not None and not 1 <= self.max_bounces <= MOST_BOUNCES:
            raise RenderError(f"between 1 and {MOST_BOUNCES} bounces are rendered, got {self.max_bounces}")

    @property
    def method(self) -> str:
        """Name of the rendering method."""
        return self.options.method

    @property
    def is_batched(self) -> bool:
        """Whether phasors of many scenes are rendered at once, where the engine can."""
        return isinstance(self.options, BatchedOptions) and not self.wants_transients

    def scenes_at_once(self, dataset: Dataset) -> int:
        """How many scenes of a dataset a worker renders at once, at most."""
        if not self.is_batched:
            return 1
        layout = self.layout(dataset)
        return max(1, min(_MOST_SCENES, _PIXELS_AT_ONCE // (layout.width * layout.height)))

    @property
    def wants_transients(self) -> bool:
        """Whether transients are written."""
        return self.product != "itof"

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that the render folder of a scene must hold."""
        return (*TRANSIENT_FILES, *IMAGE_FILES) if self.wants_transients else IMAGE_FILES

    def layout(self, dataset: Dataset) -> TransientLayout:
        """Image size and time axis of a dataset that is rendered with these settings.

        Raises
        ------
        RenderError : the resolution does not have the camera's aspect ratio, the image has too many pixels,
            the time axis is so long that one image row does not fit into memory, or a transient is larger
            than OpenEXR can write.
        """
        camera, axis = dataset.preset.camera, dataset.preset.transient
        width, height = self.resolution or (camera.width, camera.height)
        if width < 1 or height < 1 or width * camera.height != height * camera.width:
            raise RenderError(
                f"the resolution {width}x{height} does not have the aspect ratio of the camera and its "
                f"projector ({camera.width}x{camera.height}): choose a multiple or a fraction of that size"
            )
        if width * height > _MOST_PIXELS:
            raise RenderError(
                f"an image of {width}x{height} pixels is too large: at most {_MOST_PIXELS} pixels"
            )
        layout = TransientLayout(width, height, axis.bin_count, axis.bin_width_m, axis.start_opl_m)
        if self.wants_transients or self.options.has_only_bins:
            needed = ["--product itof"] if self.wants_transients else []
            needed += ["--method many-light"] if self.options.has_only_bins else []
            _check_memory(layout, " ".join(needed))
        if self.wants_transients:
            _check_file_size(layout)
        return layout

    def bounces(self, dataset: Dataset) -> int:
        """Most surfaces that light may meet."""
        own = dataset.preset.transient.max_bounces
        return own if self.max_bounces is None else self.max_bounces

    def recipe(self, dataset: Dataset, scene_sha256: str) -> str:
        """Everything that determines the pixels of a scene, as JSON. Equal recipes give equal renders.

        Device and program versions are not part of it, because they change pixels by rounding only.

        Parameters
        ----------
        scene_sha256 : digest of the scene's files (`scenegen.scene_folder.folder_digest`).
        """
        edges = self.options.edge_divisions
        # Not in recipes of the finest division: they are older than the others.
        coarser = {EDGES_KEY: edges} if edges < FINEST_EDGES else {}
        return json.dumps({**self.common_recipe(dataset), **coarser, "scene_sha256": scene_sha256})

    def as_data(self, dataset: Dataset) -> dict[str, Any]:
        """The settings as plain data, for a dataset."""
        return {"product": self.product, "device": self.device, **self.common_recipe(dataset)}

    def common_recipe(self, dataset: Dataset) -> dict[str, Any]:
        """The part of a recipe that is the same for all scenes of a dataset."""
        layout = self.layout(dataset)
        return {
            "method": self.method,
            "options": recipe_options(self.options),
            "max_bounces": self.bounces(dataset),
            "size": [layout.width, layout.height],
            "bins": [layout.bin_count, layout.bin_width_m, layout.start_opl_m],
            "frequencies_hz": list(dataset.preset.itof.frequencies_hz),
        }


def satisfies(recipe: str, wanted: str) -> bool:
    """Whether a render with one recipe is as good as one with the recipe `wanted`.

    The recipes may differ in one thing: earlier versions divided pixels with edges as finely for every error
    as for the smallest ones.
    """
    settings = read_recipe(wanted)
    is_coarser = settings.pop(EDGES_KEY, None) is not None
    return recipe == wanted or (is_coarser and recipe == json.dumps(settings))


def settings_of(rendering: RenderingRecord, dataset: Dataset) -> RenderSettings:
    """The settings that a dataset was rendered with, from its record in ``renders/rendering.json``.

    Raises
    ------
    RenderError : a method, product, option or size that this version does not know or cannot render.
    """
    camera = dataset.preset.camera
    size = (rendering.width, rendering.height)
    bounces = rendering.max_bounces
    try:
        settings = RenderSettings(
            product=rendering.product,  # type: ignore[arg-type]
            options=recorded_options(rendering.method, rendering.options),
            max_bounces=None if bounces == dataset.preset.transient.max_bounces else bounces,
            resolution=None if size == (camera.width, camera.height) else size,
        )
        settings.layout(dataset)
    except (TypeError, ValueError) as error:
        raise RenderError(
            f"{dataset.renders / RENDERING_FILE} cannot be used ({error}): delete it and give the settings "
            "again"
        ) from None
    return settings


def settings_for(dataset: Dataset, given: dict[str, Any]) -> RenderSettings:
    """Settings of a run: those in ``renders/rendering.json``, if it exists, with the given changes.

    Parameters
    ----------
    given : fields of `RenderSettings`, ``method``, and options of the method (`render.options`), by name.
        With another method, or with any option of the method, its other options get their default values.

    Raises
    ------
    OptionError, RenderError : an unknown method or option, or a value that is not allowed.
    """
    before = dataset.rendering
    settings = settings_of(before, dataset) if before else RenderSettings(product="both")
    known = option_names()
    options = {name: value for name, value in given.items() if name in known}
    others = {name: value for name, value in given.items() if name not in known}
    if {"lights", "error"} <= options.keys():
        raise RenderError("--lights gives the number of points, which --error would choose: leave one out")
    product = given.get("product", settings.product)
    method = others.pop("method", None) or _usual_method(settings.method, product, options, before is None)
    if method == BatchedOptions.method and product != "itof":
        raise RenderError("method batched renders phasors only: give --product itof, or --method many-light")
    if options or method != settings.method:
        if isinstance(settings.options, BatchedOptions) and method == ManyLightOptions.method and not options:
            options = {"error": settings.options.error}
        others["options"] = options_of(method, options)
    return replace(settings, **others)


def _usual_method(earlier: str, product: Product, options: dict[str, Any], is_first: bool) -> str:
    """The method where none is given: that of the earlier run, if it suits; batched for first phasors."""
    if product != "itof":
        return ManyLightOptions.method if earlier == BatchedOptions.method else earlier
    suits = is_first and set(options) <= {"error"}
    return BatchedOptions.method if suits else earlier


def _check_file_size(layout: TransientLayout) -> None:
    """Refuse a transient that OpenEXR cannot write."""
    if layout.raw_bytes > MOST_WRITTEN_BYTES:
        raise RenderError(
            f"a transient of {layout.width}x{layout.height} pixels and {layout.bin_count} bins has "
            f"{layout.raw_bytes / 1e9:.2f} GB, and OpenEXR writes at most {MOST_WRITTEN_BYTES / 1e9:.2f} GB: "
            "use fewer bins, fewer pixels, or --product itof"
        )


def _check_memory(layout: TransientLayout, other: str) -> None:
    """Refuse, before rendering starts, a time axis so long that one image row does not fit into memory."""
    needed = _WORKING_COPIES * 4 * layout.width * layout.bin_count
    memory = machine_bytes()
    if needed > memory or layout.width * layout.bin_count >= 2**31:
        raise RenderError(
            f"one image row of {layout.width} pixels x {layout.bin_count} bins needs {needed / 1e9:.2g} GB "
            f"of this machine's {memory / 1e9:.2g} GB: use fewer bins, fewer pixels, or {other}"
        )
