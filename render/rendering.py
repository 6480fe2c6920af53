"""Rendering the scenes of a dataset into EXR files, one scene at a time, resumable."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

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
from render.method import View
from render.methods import DEFAULT_METHOD, METHODS
from render.mirrored import trace_ground_truth
from scenegen import Dataset, whole_file

if TYPE_CHECKING:
    import mitsuba as mi

TRANSIENTS = {"scene.xml": "transient.exr", "mirrored.xml": "mirrored_transient.exr"}
IMAGES = ("itof.exr", "mirrored.exr")
# One bounce has no Monte Carlo noise but the pixel's own footprint, which 256 stratified paths integrate.
_MIRRORED_SPP = 256

log = logging.getLogger(__name__)


class RenderError(ValueError):
    """A scene that cannot be rendered as asked."""


@dataclass(frozen=True)
class RenderSettings:
    """How to render.

    Attributes
    ----------
    method : name of a rendering method.
    spp : paths per pixel.
    device : auto, cpu or cuda.
    resolution : (width, height) instead of the preset's, with the same aspect ratio.
    """

    method: str = DEFAULT_METHOD
    spp: int = 4096
    device: Device = "auto"
    resolution: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise RenderError(f"no rendering method {self.method}: choose {' or '.join(sorted(METHODS))}")
        if self.spp < 1:
            raise RenderError(f"a pixel needs at least one path, got {self.spp}")


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
            self.frequencies_hz, self.layout.bin_count, self.layout.bin_width_m, self.layout.start_opl_m
        )
        self.variant = select_variant(settings.device)
        make = METHODS[settings.method]
        self._method = make(settings.spp, self.variant)
        self._mirrored_method = make(min(settings.spp, _MIRRORED_SPP), self.variant)

    def is_done(self, scene_id: str) -> bool:
        """Whether all files of a scene are there, rendered from these settings and this scene."""
        expected = self._recipe(scene_id)
        folder = self.dataset.render_folder(scene_id)
        try:
            for name in TRANSIENTS.values():
                with TransientReader(folder / name) as reader:
                    if reader.attributes.get("recipe") != expected:
                        return False
            return all(read_image(folder / name).attributes.get("recipe") == expected for name in IMAGES)
        except ImageFileError:
            return False

    def render(self, scene_id: str) -> None:
        """Render a scene and its mirrored twin into ``renders/<id>/``; each file appears whole.

        Raises
        ------
        RenderError : Mitsuba cannot load the scene, or a pixel came out as NaN or infinite.
        """
        scene = self.dataset.scene(scene_id)
        folder = self.dataset.render_folder(scene_id)
        attributes = self._attributes(scene_id)
        loaded = self._load(scene_id, "scene.xml")
        view = View(self.layout, scene.max_bounces, scene.seed)
        measured = self._stream(scene_id, loaded, view, folder / TRANSIENTS["scene.xml"], attributes)
        self._write(folder / "itof.exr", phasor_channels(measured, self.frequencies_hz), attributes)

        mirrored = self._load(scene_id, "mirrored.xml")
        # Another stream than the scene's own: the two measurements must not share their noise.
        seed = int(np.random.SeedSequence([scene.seed, 1]).generate_state(1)[0])
        view = View(self.layout, 1, seed)
        self._stream(scene_id, mirrored, view, folder / TRANSIENTS["mirrored.xml"], attributes, mirrored=True)
        truth = trace_ground_truth(mirrored, self.layout.width, self.layout.height)
        reference_hz = self.frequencies_hz[0]
        channels: dict[str, NDArray[np.float32]] = {
            "depth.R": truth.radial_depth_m.astype(np.float32),
            "mask.M": truth.mask.astype(np.float32),
            **phasor_channels(truth.phasor(reference_hz)[..., None], [reference_hz]),
        }
        self._write(folder / "mirrored.exr", channels, attributes)

    def _stream(
        self,
        scene_id: str,
        loaded: mi.Scene,
        view: View,
        path: Path,
        attributes: dict[str, str],
        *,
        mirrored: bool = False,
    ) -> NDArray[np.complex128]:
        """Render into a transient file row block by row block; returns its (H, W, F) phasors."""
        method = self._mirrored_method if mirrored else self._method
        phasors = []
        with whole_file(path) as partial, TransientWriter(partial, view.layout, attributes) as writer:
            for block in _finite(method.row_blocks(loaded, view), f"scene {scene_id}: {path.name}"):
                writer.write_rows(block)
                phasors.append(self._phi.apply_streaming([block]))
        return np.concatenate(phasors)

    def _write(
        self, path: Path, channels: dict[str, NDArray[np.float32]], attributes: dict[str, str]
    ) -> None:
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
            "spp": str(self.settings.spp),
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
            "spp": self.settings.spp,
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
    return TransientLayout(width, height, axis.bin_count, axis.bin_width_m, axis.start_opl_m)


def _finite(blocks: Iterator[NDArray[np.float32]], what: str) -> Iterator[NDArray[np.float32]]:
    for block in blocks:
        if not np.isfinite(block).all():
            raise RenderError(f"{what} came out with NaN or infinite pixels: nothing was written")
        yield block
