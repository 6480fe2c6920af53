"""Rendering the scenes of a dataset into EXR files, one scene at a time, resumable."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from itof import (
    ImageFileError,
    MeasurementMatrix,
    TransientLayout,
    TransientReader,
    TransientWriter,
    phasor_channels,
    read_image,
    write_image,
)
from render.backend import Device, select_variant
from render.hidden_surface import HiddenSurfaceError
from render.method import Exposure, MethodOptions, View
from render.methods import DEFAULT_METHOD, METHODS
from render.mirrored import trace_ground_truth
from render.scene_checks import SceneError
from scenegen import Dataset, Scene, whole_file

if TYPE_CHECKING:
    import mitsuba as mi

Product = Literal["transient", "itof", "both"]
PRODUCTS: tuple[Product, ...] = ("transient", "itof", "both")
SCENE_TRANSIENT, MIRRORED_TRANSIENT = "transient.exr", "mirrored_transient.exr"
IMAGES = ("itof.exr", "mirrored.exr")
# One bounce has no Monte Carlo noise but the pixel's own footprint, which 256 stratified paths integrate.
_MIRRORED_SPP = 256
_MOST_PIXELS = 2**26  # all of an image's rays are in flight at once for the ground truth
_WORKING_COPIES = 4  # of a block of rows: bins, numpy's copy, a sum in double precision

log = logging.getLogger(__name__)


class RenderError(ValueError):
    """A scene that cannot be rendered as asked."""


@dataclass(frozen=True)
class RenderSettings:
    """How to render.

    Attributes
    ----------
    method : name of a rendering method.
    product : ``itof``: phasors and ground truth; ``transient`` or ``both``: transients as well.
    options : what the method can be told.
    max_bounces : surfaces that light may meet, instead of the preset's.
    device : auto, cpu or cuda.
    resolution : (width, height) instead of the preset's, with the same aspect ratio.
    """

    method: str = DEFAULT_METHOD
    product: Product = "itof"
    options: MethodOptions = field(default_factory=MethodOptions)
    max_bounces: int | None = None
    device: Device = "auto"
    resolution: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise RenderError(f"no rendering method {self.method}: choose {' or '.join(sorted(METHODS))}")
        if self.product not in PRODUCTS:
            raise RenderError(f"no product {self.product}: choose one of {', '.join(PRODUCTS)}")
        if not self.options.error > 0:
            raise RenderError(f"the hidden-signal error must be above 0, got {self.options.error}")
        for name, value in (("spp", self.options.spp), ("lights", self.options.lights)):
            if value is not None and value < 1:
                raise RenderError(f"--{name} must be at least 1, got {value}")


class Renderer:
    """Renders scenes of one dataset with one method on one device.

    Raises
    ------
    RenderError : a resolution of another aspect ratio than the camera's.
    BackendError : the device cannot render here.
    """

    def __init__(self, dataset: Dataset, settings: RenderSettings) -> None:
        self.dataset = dataset
        self.settings = settings
        self.layout = _layout(dataset, settings)
        self.frequencies_hz = dataset.preset.itof.frequencies_hz
        self._phi = MeasurementMatrix(
            self.frequencies_hz,
            self.layout.bin_count,
            self.layout.bin_width_m,
            self.layout.start_opl_m,
            splat="tent",
        )
        _check_memory(self.layout, settings.product)
        self.variant = select_variant(settings.device)
        make = METHODS[settings.method]
        self._method = make(settings.options, self.variant)
        mirrored = replace(settings.options, spp=min(settings.options.spp, _MIRRORED_SPP))
        self._mirrored_method = make(mirrored, self.variant)

    def is_done(self, scene_id: str) -> bool:
        """Whether all files of a scene are there, rendered from these settings and this scene."""
        expected = self._recipe(scene_id)
        folder = self.dataset.render_folder(scene_id)
        try:
            for name in (SCENE_TRANSIENT, MIRRORED_TRANSIENT) if self._wants_transients else ():
                with TransientReader(folder / name) as reader:
                    if reader.attributes.get("recipe") != expected:
                        return False
                    # The last row ends the file, so a truncated one fails here.
                    reader.read_rows(reader.layout.height - 1, reader.layout.height)
            return all(read_image(folder / name).attributes.get("recipe") == expected for name in IMAGES)
        except ImageFileError:
            return False

    def render(self, scene_id: str) -> None:
        """Render a scene and its mirrored twin into ``renders/<id>/``; each file appears whole.

        Raises
        ------
        RenderError : Mitsuba cannot load the scene, the method cannot render it, or a pixel came out as NaN
            or infinite.
        """
        scene = self.dataset.scene(scene_id)
        attributes = self._attributes(scene_id)
        self._remove_stale_transients(scene_id)
        self._render_measurement(scene, attributes)
        self._render_mirrored(scene, attributes)

    @property
    def _wants_transients(self) -> bool:
        return self.settings.product != "itof"

    def _remove_stale_transients(self, scene_id: str) -> None:
        """Transients of another recipe must not stand beside new phasors."""
        for name in (SCENE_TRANSIENT, MIRRORED_TRANSIENT):
            file = self.dataset.render_folder(scene_id) / name
            try:
                with TransientReader(file) as reader:
                    stale = reader.attributes.get("recipe") != self._recipe(scene_id)
            except ImageFileError:
                stale = file.is_file()
            if stale:
                file.unlink()

    def _render_measurement(self, scene: Scene, attributes: dict[str, str]) -> None:
        folder = self.dataset.render_folder(scene.id)
        view = View(
            self.layout, self.frequencies_hz, self.settings.max_bounces or scene.max_bounces, scene.seed
        )
        try:
            exposure = self._method.expose(self._load(scene.id, "scene.xml"), view)
        except (SceneError, HiddenSurfaceError) as error:
            raise RenderError(f"scene {scene.id}: {error}") from None
        exact = exposure.phasors(self.frequencies_hz)
        attributes = {**attributes, **exposure.attributes, "seed": str(view.seed)}
        binned = None
        if self._wants_transients:
            binned = self._write_rows(exposure, folder / SCENE_TRANSIENT, attributes)
        if exact is not None:
            parts = {"itof": exact.total, "direct": exact.direct, "hidden": exact.hidden}
        elif binned is not None:
            parts = {"itof": binned}
        else:
            what = f"scene {scene.id}: the measurement"
            rows = [self._phi.apply_streaming([block]) for block in _finite(exposure.row_blocks(), what)]
            parts = {"itof": np.concatenate(rows)}
        channels: dict[str, NDArray[np.float32]] = {}
        for prefix, phasor in parts.items():
            channels |= phasor_channels(phasor, self.frequencies_hz, prefix)
        self._write(folder / "itof.exr", channels, attributes)

    def _render_mirrored(self, scene: Scene, attributes: dict[str, str]) -> None:
        folder = self.dataset.render_folder(scene.id)
        mirrored = self._load(scene.id, "mirrored.xml")
        if self._wants_transients:
            # Another stream than the scene's own: the two measurements must not share their noise.
            seed = int(np.random.SeedSequence([scene.seed, 1]).generate_state(1)[0])
            view = View(self.layout, self.frequencies_hz, 1, seed)
            exposure = self._mirrored_method.expose(mirrored, view)
            more = {**exposure.attributes, "seed": str(seed)}
            self._write_rows(exposure, folder / MIRRORED_TRANSIENT, attributes | more)
        truth = trace_ground_truth(mirrored, self.layout.width, self.layout.height)
        reference_hz = self.frequencies_hz[0]
        channels: dict[str, NDArray[np.float32]] = {
            "depth.R": truth.radial_depth_m.astype(np.float32),
            "mask.M": truth.mask.astype(np.float32),
            **phasor_channels(truth.phasor(reference_hz)[..., None], [reference_hz]),
        }
        self._write(folder / "mirrored.exr", channels, attributes)

    def _write_rows(
        self, exposure: Exposure, path: Path, attributes: dict[str, str]
    ) -> NDArray[np.complex128]:
        """Render into a transient file row block by row block; returns its (H, W, F) phasors."""
        what = f"scene {attributes['scene_id']}: {path.name}"
        phasors = []
        with whole_file(path) as partial, TransientWriter(partial, self.layout, attributes) as writer:
            for block in _finite(exposure.row_blocks(), what):
                writer.write_rows(block)
                phasors.append(self._phi.apply_streaming([block]))
        return np.concatenate(phasors)

    def _write(
        self, path: Path, channels: dict[str, NDArray[np.float32]], attributes: dict[str, str]
    ) -> None:
        if not all(np.isfinite(values).all() for values in channels.values()):
            raise RenderError(f"scene {attributes['scene_id']}: {path.name} came out with NaN: not written")
        with whole_file(path) as partial:
            write_image(partial, channels, attributes)

    def _load(self, scene_id: str, name: str) -> mi.Scene:
        import mitsuba as mi

        file = self.dataset.scene_folder(scene_id) / name
        if not file.is_file():
            raise RenderError(f"{file} is missing: run night-gen scenes again")
        try:
            # optimize merges meshes of one material, and with them the ids that name what a ray met.
            return mi.load_file(str(file), optimize=False)
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise RenderError(f"Mitsuba cannot load {file}: {reason}") from None

    def _attributes(self, scene_id: str) -> dict[str, str]:
        return {
            "generator": f"night-render {version('night-nlos')}",
            "mitsuba_version": version("mitsuba"),
            "mitransient_version": version("mitransient"),
            "variant": self.variant,
            "scene_id": scene_id,
            "method": self.settings.method,
            "splat": "tent",
            "frequencies_hz": json.dumps(self.frequencies_hz),
            "recipe": self._recipe(scene_id),
        }

    def _recipe(self, scene_id: str) -> str:
        """All that a scene's pixels depend on; a render with the same recipe need not be made again."""
        digest = hashlib.sha256()
        for file in sorted(self.dataset.scene_folder(scene_id).glob("*")):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
        layout = self.layout
        recipe = {
            "method": self.settings.method,
            "options": asdict(self.settings.options),
            "max_bounces": self.settings.max_bounces,
            "size": [layout.width, layout.height],
            "bins": [layout.bin_count, layout.bin_width_m, layout.start_opl_m],
            "frequencies_hz": self.frequencies_hz,
            "scene_sha256": digest.hexdigest(),
        }
        return json.dumps(recipe)


def _layout(dataset: Dataset, settings: RenderSettings) -> TransientLayout:
    camera, axis = dataset.preset.camera, dataset.preset.transient
    width, height = settings.resolution or (camera.width, camera.height)
    if width < 1 or height < 1 or width * camera.height != height * camera.width:
        raise RenderError(
            f"a resolution of {width}x{height} has not the aspect ratio of the camera and its projector "
            f"({camera.width}x{camera.height}): choose a multiple or a fraction of that"
        )
    if width * height > _MOST_PIXELS:
        raise RenderError(f"an image of {width}x{height} pixels is too large: at most {_MOST_PIXELS} pixels")
    return TransientLayout(width, height, axis.bin_count, axis.bin_width_m, axis.start_opl_m)


def _check_memory(layout: TransientLayout, product: Product) -> None:
    """Refuse a time axis of which not even one image row fits, before rendering starts."""
    if product == "itof":
        return
    needed = _WORKING_COPIES * 4 * layout.width * layout.bin_count
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > memory or layout.width * layout.bin_count >= 2**31:
        raise RenderError(
            f"one image row of {layout.width} pixels x {layout.bin_count} bins needs {needed / 1e9:.2g} GB "
            f"of this machine's {memory / 1e9:.2g} GB: use fewer bins, fewer pixels, or --product itof"
        )


def _finite(blocks: Iterator[NDArray[np.float32]], what: str) -> Iterator[NDArray[np.float32]]:
    for block in blocks:
        if not np.isfinite(block).all():
            raise RenderError(f"{what} came out with NaN or infinite pixels: this file was not written")
        yield block
