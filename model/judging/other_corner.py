"""Whether a network knows the corner of a dataset, as `model.predict_file` asks of a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from itof.wall.expected_wall import angle_deg, distance_m
from itof.wall.finding import Finding
from itof.wall.plausibility import elsewhere, shift_words
from itof.wall.wall_view import WallView
from model.judging.refusals import EvaluationError
from model.prediction.fields_of_view import view_findings
from model.run_folder.networks import View, Wanted, wall_shift_m, what_to_do
from model.run_folder.run_config import RunConfig
from scenegen import Camera, Dataset, Scene
from scenegen.pose import wall_geometry
from scenegen.scene import Wall


def refuse_other_corner(
    trained: RunConfig, dataset: Dataset, scenes: Sequence[str], run: Path, *, force: bool
) -> tuple[str, ...]:
    """What is unlike the training in the geometry of the scenes with these ids, as sentences.

    Raises
    ------
    EvaluationError : with it, predictions are useless; not with `force`.
    """
    found: dict[str, Finding] = {}  # the worst of each kind
    for scene in scenes:
        for finding in _findings(trained, dataset, dataset.scene(scene)):
            if finding.code not in found or (finding.refused and not found[finding.code].refused):
                words = f"scene {scene}: {finding.sentence}"
                found[finding.code] = Finding(finding.code, words, finding.refused)
    sentences = tuple(finding.sentence for finding in found.values())
    if not force and any(finding.refused for finding in found.values()):
        size, frequencies_hz = (trained.image_width, trained.image_height), dataset.preset.itof.frequencies_hz
        views = {_view(each.camera, each.relay_wall) for each in map(dataset.scene, scenes)}
        other = what_to_do(Wanted(*size, frequencies_hz, tuple(views)))
        raise EvaluationError(
            f"{dataset.root} is not what {run} was trained on: {'; '.join(sentences)}; {other}; with --force "
            "(force=True) it is judged all the same"
        )
    return sentences


def _findings(trained: RunConfig, dataset: Dataset, scene: Scene) -> Iterator[Finding]:
    """A field of view and a wall that are not those of the training.

    The direct return of the scene's own wall is known. What remains is that of `itof.wall.plausibility` for a
    run that calibrates itself: hidden light falls elsewhere. Of scenes with cameras elsewhere, those in the
    middle count if the run does not say how far away it has seen walls.
    """
    yield from view_findings(trained, [scene.camera.horizontal_fov_deg])
    seen_m, is_one_corner = trained.inputs.largest_shift_m, dataset.preset.is_one_corner
    camera = scene.camera if seen_m or is_one_corner else dataset.preset.camera
    view, known = _view(camera, scene.relay_wall), trained.geometry.plane_per_m
    own = np.array(view.plane_per_m)
    words = shift_words(distance_m(own) - distance_m(known), angle_deg(own, known))
    yield from elsewhere(wall_shift_m(trained.geometry, view), words, "the run", seen_m)


def _view(camera: Camera, relay_wall: Wall) -> View:
    """What is known of a scene's camera."""
    plane_per_m = WallView(**wall_geometry(camera, relay_wall)).plane_per_m
    return View(camera.horizontal_fov_deg, tuple(plane_per_m.tolist()))
