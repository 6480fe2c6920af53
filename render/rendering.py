"""Renders one scene of a dataset into EXR files and writes a record of these files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from disk import whole_file, whole_files
from disk.sealed_files import SealedFiles, write_sealed
from itof import (
    DepthMap,
    MeasurementMatrix,
    Splat,
    TransientWriter,
    compressing_with_threads,
    phasor_channels,
)
from itof.exr.image import FIELD_OF_VIEW, PROJECTOR
from render.backend import drjit_threads, select_variant, versions
from render.batch.light import BOUNCES, SceneLight, suits
from render.batch.scene_lights import SceneLights
from render.edited_scenes import edited_attributes, is_edited, refuse_edited, refuse_measured, refuse_unlike
from render.options import BatchedOptions
from render.render_files import begin, finish, image_file, record_of
from render.room_layer import refuse_room, room_layer
from render.settings import RenderError, RenderSettings
from render.transport.lights.hidden_surface import HiddenSurfaceError
from render.transport.many_light import ManyLight
from render.transport.method import Exposure, View
from render.transport.methods import METHODS
from render.transport.mirrored import trace_ground_truth
from render.transport.passes.transient_pass import LostLightError
from render.transport.scene_checks import SceneError
from render.transport.scene_loading import scene_from_data
from scenegen import (
    GROUND_TRUTH_FILE,
    IMAGE_FILES,
    MEASUREMENT_FILE,
    MIRRORED_TRANSIENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILE,
    TRANSIENT_FILES,
    Dataset,
    RenderRecord,
    Scene,
    write_record,
)
from scenegen.mitsuba_description import mirrored_description, seen_description
from scenegen.render_folder import record_text
from scenegen.scene_folder import digest_of, read_scene_folder, scene_of

_Result = TypeVar("_Result")
_CAMERA = ("camera_location_m", "camera_rotation_deg")  # attributes, and fields of the camera
_SPLAT: Splat = "quadratic"  # of all methods: `render.transport.time_bins.splat_quadratic`


@dataclass(frozen=True)
class _Source:
    """A scene as it was read: its data, its folder, and contents and digest of all files there."""

    scene: Scene
    folder: Path
    files: Mapping[str, bytes]
    digest: str


class Renderer:
    """Renders scenes of one dataset with one method on one device.

    Raises
    ------
    RenderError : the settings do not fit the dataset (see `RenderSettings.layout`).
    BackendError : this machine cannot render on the requested device.
    """

    def __init__(self, dataset: Dataset, settings: RenderSettings) -> None:
        self.dataset = dataset
        self.settings = settings
        self.layout = settings.layout(dataset)
        self.frequencies_hz = dataset.preset.itof.frequencies_hz
        self.variant = select_variant(settings.device)
        self._libraries = ThreadpoolController()  # which finds numpy's and scipy's linear algebra
        make = METHODS[settings.method]
        self._method = make(settings.options, self.variant)
        self._mirrored_method = make(settings.options.for_one_bounce(), self.variant)

    def render(self, scene_id: str) -> RenderRecord:
        """`render_all` of one scene.

        Raises
        ------
        RenderError : the scene's files are not those that ``dataset.json`` vouches for (unless the settings
            accept that), the method cannot render the scene, or a pixel is NaN or infinite.
        NightError : a file of the scene is missing or damaged.
        """
        (result,) = self.render_all([scene_id])
        if isinstance(result, Exception):
            raise result
        return result

    def render_all(self, scene_ids: Sequence[str]) -> Iterator[RenderRecord | Exception]:
        """Render scenes and their mirrored scenes into ``renders/<id>/``; yield the records of the files.

        A scene that cannot be rendered gives its error. The files of a scene do not depend on the others.

        Each file is written whole or not at all. The earlier record is deleted when all files are written,
        before the first one gets its name, and the new record is written last. So a record never describes
        other files, and a rendering that fails leaves the earlier render, unless that has other settings. The
        scene's files are read once: the bytes that are compared with ``dataset.json`` are those that are
        rendered.
        """
        # Matrix products round differently on one thread and on two: files must not depend on the workers.
        with (
            self._libraries.limit(limits=1, user_api="blas"),
            compressing_with_threads(drjit_threads()),
        ):
            sources = [_result(self._read, scene_id) for scene_id in scene_ids]
            found = [each for each in sources if isinstance(each, _Source)]
            done = self._written(found, self._lights(found))
            for source in sources:
                if not isinstance(source, _Source):
                    yield source
                elif (result := done.get(source.scene.id)) is not None:
                    yield result
                else:
                    yield _result(self._render, source)

    def _lights(self, sources: Sequence[_Source]) -> dict[str, SceneLight]:
        """The batched engine's light of scenes, by id: exact enough, and some of it hidden or none at all."""
        if self._engine is None or self.settings.bounces(self.dataset) != BOUNCES:
            return {}
        suited = [each for each in sources if suits(each.scene) and not self._is_edited(each)]
        found = self._engine.of([(each.scene, each.files) for each in suited]).items()
        return {k: i for k, i in found if i.error <= self._engine.error and (i.hidden.any() or i.error == 0)}

    @cached_property
    def _engine(self) -> SceneLights | None:
        """The batched engine, if the settings want it."""
        options, size = self.settings.options, (self.layout.width, self.layout.height)
        if not isinstance(options, BatchedOptions) or self.settings.wants_transients:
            return None
        return SceneLights(self.frequencies_hz, *size, error=options.error, device=self.settings.device)

    def _is_edited(self, source: _Source) -> bool:
        return is_edited(self.dataset, source.scene.id, source.digest)

    def _written(
        self, sources: Sequence[_Source], lights: Mapping[str, SceneLight]
    ) -> dict[str, RenderRecord | Exception]:
        """Write the files of scenes that have light, together; return the record or error of each, by id."""
        done: dict[str, RenderRecord | Exception] = {}
        made: list[tuple[SealedFiles, RenderRecord]] = []
        for source in (each for each in sources if each.scene.id in lights):
            result = _result(self._light_files, source, lights[source.scene.id])
            if isinstance(result, Exception):
                done[source.scene.id] = result
            else:
                made.append(result)
        for (files, record), error in zip(made, write_sealed([each for each, _ in made]), strict=True):
            done[files.folder.name] = _result(finish, files.folder, record) if error is None else error
        return done

    def _render(self, source: _Source) -> RenderRecord:
        folder, attributes, forget = self._begun(source)
        with whole_files(folder, before=forget) as stage:
            measured = self._render_measurement(source, attributes, stage)
            self._render_mirrored(source, attributes, stage)
        names = (*TRANSIENT_FILES, *IMAGE_FILES)
        record = record_of(measured, {n: folder / n for n in names if (folder / n).is_file()})
        write_record(folder, record)
        return finish(folder, record)

    def _begun(self, source: _Source) -> tuple[Path, dict[str, str], Callable[[], None]]:
        """Render folder of a scene, attributes of its files, and what forgets the earlier render."""
        scene_id = source.scene.id
        folder = self.dataset.render_folder(scene_id)
        recipe = self.settings.recipe(self.dataset, source.digest)
        forget = begin(folder, recipe, keeps_transients=not self.settings.wants_transients)
        edited = edited_attributes(self.dataset, scene_id, source.digest)
        own = {} if source.scene.has_flash else {PROJECTOR: "own"}
        return folder, {**self._attributes(source.scene), **own, **edited, "recipe": recipe}, forget

    def _read(self, scene_id: str) -> _Source:
        refuse_measured(self.dataset)
        folder = self.dataset.scene_folder(scene_id)
        files = read_scene_folder(folder)
        digest = digest_of(files)
        if is_edited(self.dataset, scene_id, digest) and not self.settings.accept_edited:
            refuse_edited(self.dataset, [scene_id])
        scene = scene_of(files, folder)
        refuse_unlike(scene, self.dataset, files, digest)
        if isinstance(self._method, ManyLight):
            refuse_room(scene, self.settings.bounces(self.dataset), self.settings.wants_transients)
        return _Source(scene, folder, files, digest)

    def _render_measurement(
        self, source: _Source, attributes: dict[str, str], folder: Path
    ) -> dict[str, str]:
        """Write the phasors and, if wanted, the transient; return the attributes of these files."""
        scene = source.scene
        view = self._view(self.settings.bounces(self.dataset), scene.seed)
        try:
            separate = isinstance(self._method, ManyLight)
            seen = seen_description(scene.in_black_room() if separate else scene)
            loaded = scene_from_data(seen, source.files, source.folder, self._method.rough_wall)
            exposure = self._method.expose(loaded, view)
        except (SceneError, HiddenSurfaceError) as error:
            raise RenderError(f"scene {scene.id}: {error}") from None
        exact = exposure.phasors()
        attributes = {**attributes, **exposure.attributes, "seed": str(view.seed)}
        binned = None
        if self.settings.wants_transients:
            binned = self._write_rows(exposure, folder / TRANSIENT_FILE, attributes, exact is None)
        if exact is not None:
            parts, more = self._parts(source, exact.direct, exact.hidden)
            attributes |= more
        elif binned is not None:
            parts = {"itof": binned}
        else:
            what, rows = f"scene {scene.id}: the measurement", exposure.lit_rows()
            parts = {"itof": self._phi(rows.bins).apply_streaming(_finite(rows.blocks, what))}
        self._write(folder / MEASUREMENT_FILE, self._channels(parts), attributes)
        return attributes

    def _light_files(self, source: _Source, light: SceneLight) -> tuple[SealedFiles, RenderRecord]:
        """Phasors, ground truth and record of the engine's light."""
        folder, attributes, forget = self._begun(source)
        made = {"method": BatchedOptions.method, "hidden_error": f"{light.error:.3g}"}
        attributes = {**attributes, **made, "seed": str(source.scene.seed)}
        parts, more = self._parts(source, light.direct, light.hidden)
        attributes |= more
        depth_m = light.radial_depth_m.astype(np.float64)
        truth = DepthMap.of_object(depth_m, depth_m > 0, self.frequencies_hz[0])
        files = {
            MEASUREMENT_FILE: image_file(MEASUREMENT_FILE, self._channels(parts), attributes),
            GROUND_TRUTH_FILE: image_file(GROUND_TRUTH_FILE, truth.channels(), attributes),
        }
        record = record_of(attributes, files)
        return SealedFiles(folder, files, (RECORD_FILE, record_text(record).encode()), forget), record

    def _parts(
        self, source: _Source, direct: NDArray[np.complexfloating], hidden: NDArray[np.complexfloating]
    ) -> tuple[dict[str, NDArray[np.complexfloating]], dict[str, str]]:
        """The light of a black room with that of the room, by prefix, and attributes of the latter."""
        parts = {"itof": direct + hidden, "direct": direct, "hidden": hidden}
        scene, method = source.scene, self._method
        if not scene.room_reflects or not isinstance(method, ManyLight):
            return parts, {}
        view = self._view(BOUNCES, scene.seed)
        room = room_layer(scene, source.files, source.folder, method, view, hidden)
        parts |= {"itof": parts["itof"] + room.phasors, "room": room.phasors}
        return parts, {"room_error": f"{room.error:.3g}"}

    def _render_mirrored(self, source: _Source, attributes: dict[str, str], folder: Path) -> None:
        scene = source.scene
        mirrored = scene_from_data(mirrored_description(scene), source.files, source.folder)
        if self.settings.wants_transients:
            # The two measurements of a scene need different random streams: their noise must be independent.
            seed = int(np.random.SeedSequence([scene.seed, 1]).generate_state(1)[0])
            view = replace(self._view(1, seed), all_is_direct=True)
            exposure = self._mirrored_method.expose(mirrored, view)
            more = {**exposure.attributes, "seed": str(seed)}
            self._write_rows(exposure, folder / MIRRORED_TRANSIENT_FILE, attributes | more)
        size = (self.layout.width, self.layout.height)
        channels = trace_ground_truth(mirrored, *size, self.frequencies_hz[0]).channels()
        self._write(folder / GROUND_TRUTH_FILE, channels, attributes)

    def _view(self, max_bounces: int, seed: int) -> View:
        return View(self.layout, self.frequencies_hz, max_bounces, seed, self.settings.accept_lost_light)

    def _write_rows(
        self, exposure: Exposure, path: Path, attributes: dict[str, str], wants_phasors: bool = False
    ) -> NDArray[np.complex128] | None:
        """Render a transient file in blocks of rows; return the (H, W, F) phasors of its bins, if wanted."""
        what = f"scene {attributes['scene_id']}: {path.name}"
        phasors, rows = [], exposure.lit_rows()
        phi = self._phi(rows.bins)
        try:
            with (
                whole_file(path) as written,
                TransientWriter(written, self.layout, attributes, rows.bins) as writer,
            ):
                for block in _finite(rows.blocks, what):
                    writer.write_rows(block)
                    if wants_phasors:
                        phasors.append(phi.apply_streaming([block]))
        except LostLightError as error:
            raise RenderError(
                f"{what}: {error}: change start_opl_m and bin_count in [transient] of the preset, or accept "
                "the loss with --accept lost-light"
            ) from None
        return np.concatenate(phasors) if wants_phasors else None

    def _phi(self, bins: range) -> MeasurementMatrix:
        """Φ of some bins of the time axis."""
        axis = self.layout.cut(bins)
        return MeasurementMatrix(
            self.frequencies_hz, axis.bin_count, axis.bin_width_m, axis.start_opl_m, splat=_SPLAT
        )

    def _write(
        self, path: Path, channels: dict[str, NDArray[np.float32]], attributes: dict[str, str]
    ) -> None:
        with whole_file(path) as written:
            written.write_bytes(image_file(path.name, channels, attributes))

    def _channels(self, parts: Mapping[str, Any]) -> dict[str, NDArray[np.float32]]:
        """EXR channels of (H, W, F) phasors, by prefix."""
        channels: dict[str, NDArray[np.float32]] = {}
        for prefix, phasor in parts.items():
            channels |= phasor_channels(phasor, self.frequencies_hz, prefix)
        return channels

    def _attributes(self, scene: Scene) -> dict[str, str]:
        return {
            **versions(),
            "variant": self.variant,
            "scene_id": scene.id,
            **{name: json.dumps(getattr(scene.camera, name.removeprefix("camera_"))) for name in _CAMERA},
            FIELD_OF_VIEW: repr(scene.camera.horizontal_fov_deg),
            "method": self._method.name,
            "splat": _SPLAT,
            "frequencies_hz": json.dumps(self.frequencies_hz),
        }


def _result(work: Callable[..., _Result], *arguments: Any) -> _Result | Exception:
    """What a function returns, or its error."""
    try:
        return work(*arguments)
    except Exception as error:  # of any kind: one bad scene must not stop the others
        return error


def _finite(blocks: Iterator[NDArray[np.float32]], what: str) -> Iterator[NDArray[np.float32]]:
    for block in blocks:
        if not np.isfinite(block).all():
            raise RenderError(f"{what} has NaN or infinite pixels: this file was not written")
        yield block
