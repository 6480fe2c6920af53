"""Whether a network knows the corner of a dataset, as `model.predict_file` asks of a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from itof import pixel_rays
from itof.wall.expected_wall import angle_deg, distance_m, radial_depth_of_plane
from itof.wall.finding import Finding
from itof.wall.plausibility import elsewhere, shift_words
from itof.wall.wall_view import WallView
from model.judging.refusals import EvaluationError
from model.prediction.fields_of_view import view_findings
from model.run_folder.run_config import RunConfig
from scenegen import Dataset, Scene
from scenegen.pose import wall_geometry

_GRID: Final = (16, 12)  # rays over an image


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
        raise EvaluationError(
            f"{dataset.root} is not what {run} was trained on: {'; '.join(sentences)}; with --force "
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
    view = WallView(**wall_geometry(camera, scene.relay_wall))
    own, known = view.plane_per_m, trained.geometry.plane_per_m
    rays = pixel_rays(*_GRID, view.horizontal_fov_deg)
    depth_m, known_m = radial_depth_of_plane(rays, own), radial_depth_of_plane(rays, known)
    ahead = np.isfinite(depth_m) & np.isfinite(known_m)
    shift_m = float(np.abs(depth_m - known_m)[ahead].mean()) if ahead.any() else np.inf
    words = shift_words(distance_m(own) - distance_m(known), angle_deg(own, known))
    yield from elsewhere(shift_m, words, "the run", seen_m)
