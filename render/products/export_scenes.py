"""The scenes of a dataset, checked and read one by one for its export."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from disk import NightError
from itof import DepthMap, Image, ImageFileError, read_image
from render.products.content_checks import has_part, wrong_phasors, wrong_pixels
from render.products.conversion import ExportError
from render.products.rendered_scene import scene_and_files
from render.settings import EDGES_KEY, settings_of
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    RENDER_AGAIN,
    Dataset,
    RenderRecord,
    Scene,
    read_bad_render,
    read_failure,
    read_recipe,
    read_record,
    recorded_file,
)
from scenegen.scene_folder import SCENE_FILE

Reason = Literal["not rendered", "given up", "found bad", "other settings", "damaged"]
_PARTS = ("direct", "hidden")


class RefusedSceneError(ExportError):
    """A scene cannot be exported.

    Attributes
    ----------
    reason : why, in words that are the same on every machine.
    """

    def __init__(self, scene_id: str, reason: Reason, problem: str) -> None:
        super().__init__(f"scene {scene_id}: {problem.removeprefix(f'scene {scene_id}: ')}")
        self.reason = reason

    def without_frames(self) -> RefusedSceneError:
        """The same error without its traceback, which would keep the images of the scene in memory."""
        self.__context__ = self.__cause__ = None
        return self.with_traceback(None)


@dataclass(frozen=True)
class ExportedScene:
    """One scene, as it is exported.

    Attributes
    ----------
    scene : the scene as plain data.
    scene_text, render_text : JSON of ``scene.json``, byte for byte, and of the record of the render.
    images : arrays by their names in `render.products.export_format.IMAGES`, each without the axis N.
    """

    scene: Scene
    scene_text: str
    render_text: str
    images: dict[str, NDArray[Any]]


class SceneSource:
    """Reads the scenes of a dataset that were rendered with the settings of ``renders/rendering.json``.

    In a dataset that ``night-render`` has never rendered, the settings are those of the first scene that is
    read, and files without a record pass.

    Raises
    ------
    RenderError : ``rendering.json`` has settings that this version does not know.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self._is_rendered = dataset.rendering is not None
        self._recipe: dict[str, Any] | None = None
        self._shapes: dict[str, tuple[int, ...]] | None = None
        if dataset.rendering is not None:
            settings = settings_of(dataset.rendering, dataset)
            self._recipe = json.loads(json.dumps(settings.common_recipe(dataset)))

    def check(self, scene_id: str) -> RenderRecord | None:
        """The record of a scene's render; None for a render of another program.

        Raises
        ------
        RefusedSceneError : the records say that the scene is not rendered, was given up, was found bad, or
            was rendered with other settings. Its images are not read.
        """
        root, folder = self.dataset.root, self.dataset.render_folder(scene_id)
        record, bad, failure = read_record(folder), read_bad_render(folder), read_failure(folder)
        if bad is not None and (record is None or bad.is_again(record)):
            again = "it was rendered twice to the same bytes, please report this defect of NIGHT"
            advice = f"run night-render {root}" if record is None else again
            problem = f"its render was found bad ({'; '.join(bad.problems)}): {advice}"
            raise RefusedSceneError(scene_id, "found bad", problem)
        if record is None and failure is not None:
            problem = f"it could not be rendered ({failure.reason}): run night-render {root} --again failed"
            raise RefusedSceneError(scene_id, "given up", problem)
        if record is None and (self._is_rendered or not (folder / MEASUREMENT_FILE).is_file()):
            raise RefusedSceneError(scene_id, "not rendered", f"it is not rendered: run night-render {root}")
        if record is not None and self._recipe not in (None, _settings(record)):
            raise RefusedSceneError(
                scene_id,
                "other settings",
                f"it is rendered with other settings than the dataset: run night-render {root} "
                "--again changed",
            )
        return record

    def read(self, scene_id: str) -> ExportedScene:
        """A scene and its images, from files that are first compared with their records.

        Raises
        ------
        RefusedSceneError : as `check`; or a file of the scene or of its render is missing, damaged, changed,
            not finite, or has other channels or another size than those of the scenes before.
        """
        record = self.check(scene_id)
        try:
            scene, text = self._scene(scene_id, record)
            images = self._images(scene_id)
        except OSError as error:
            problem = f"{error.filename or 'a file'} cannot be read ({error.strerror or error})"
            raise RefusedSceneError(scene_id, "damaged", problem) from None
        except NightError as error:
            raise RefusedSceneError(scene_id, "damaged", str(error)) from None
        shapes = {name: values.shape for name, values in images.items()}
        if self._shapes not in (None, shapes):
            problem = f"its images are not those of the scenes before ({_listed(shapes)}): render it again"
            raise RefusedSceneError(scene_id, "other settings", problem)
        self._shapes = shapes
        if not self._is_rendered and self._recipe is None and record is not None:
            self._recipe = _settings(record)
        return ExportedScene(scene, text, json.dumps(record and asdict(record)), images)

    def _scene(self, scene_id: str, record: RenderRecord | None) -> tuple[Scene, str]:
        """A scene and the text of its ``scene.json``, if its files are those that were rendered."""
        scene, files = scene_and_files(self.dataset, scene_id, record)
        return scene, files[SCENE_FILE].decode()

    def _images(self, scene_id: str) -> dict[str, NDArray[Any]]:
        file = recorded_file(self.dataset, scene_id, MEASUREMENT_FILE)
        image = read_image(file, advice=RENDER_AGAIN)
        truth_file = recorded_file(self.dataset, scene_id, GROUND_TRUTH_FILE)
        truth_image = read_image(truth_file, advice=RENDER_AGAIN)
        height, width = image.phasors()[0].shape[:2]
        problems = [
            *wrong_pixels(MEASUREMENT_FILE, image, (height, width)),
            *wrong_pixels(GROUND_TRUTH_FILE, truth_image, (height, width)),
        ]
        frequencies_hz = self.dataset.preset.itof.frequencies_hz
        problems = problems or list(wrong_phasors(image, frequencies_hz))
        if problems:
            raise ExportError(f"{problems[0]} (in {file.parent}): {RENDER_AGAIN}")
        return {**_measured(image), **_truth(truth_image, truth_file, frequencies_hz[0])}


def _settings(record: RenderRecord) -> dict[str, Any]:
    """The part of a recipe that is the same for all scenes of a dataset."""
    own = ("scene_sha256", EDGES_KEY)  # renders of earlier versions have other edges (`satisfies`)
    return {name: value for name, value in read_recipe(record.recipe).items() if name not in own}


def _measured(image: Image) -> dict[str, NDArray[Any]]:
    parts = {f"{part}_phasors": image.phasors(part)[0] for part in _PARTS if has_part(image, part)}
    return {"phasors": image.phasors()[0], **parts}


def _truth(image: Image, file: Path, frequency_hz: float) -> dict[str, NDArray[Any]]:
    try:
        truth = DepthMap.of_image(image)
    except ImageFileError as error:
        raise ExportError(f"{file} {error}: {RENDER_AGAIN}") from None
    if truth.frequency_hz != frequency_hz:
        raise ExportError(
            f"{file} has its phasor at {truth.frequency_hz:g} Hz, not at {frequency_hz:g} Hz: {RENDER_AGAIN}"
        )
    return {
        "mirrored_phasors": truth.phasor,
        "radial_depth_m": truth.radial_depth_m,
        "mask": truth.mask.astype(np.uint8),
    }


def _listed(shapes: dict[str, tuple[int, ...]]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, shape))}" for name, shape in shapes.items())
