"""The film of a sequence: truth beside prediction, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from itof.pictures.depth_film import MOST_FRAMES, FilmFrame, write_depth_film
from itof.pictures.figures import depth_range
from model.judging.judging import Bench, shown_scenes
from model.judging.report.scenes_figure import describe
from model.judging.results import Report

FILM_FILE: Final = "film.gif"  # in the folder of a report


def write_sequence_film(folder: Path, bench: Bench, report: Report) -> None:
    """Write the film of a sequence, of at most `MOST_FRAMES` of its frames; nothing for other datasets.

    The colours are those of the true depths of all frames.
    """
    if report.frame_rate_hz is None:
        return
    step = -(-len(report.scenes) // MOST_FRAMES)
    chosen = {result.scene: result for result in report.scenes[::step]}
    ranges_m = [depth_range(scene.truth) for scene in shown_scenes(bench, chosen) if scene.truth.mask.any()]
    nears_m, fars_m = zip(*ranges_m or [(0.0, 1.0)], strict=True)

    def frames() -> Iterator[FilmFrame]:
        for scene in shown_scenes(bench, chosen):
            said = f"{report.seconds(scene.result):.2f} s: {describe(scene.result.prediction)}"
            yield FilmFrame(said, {"truth": scene.truth, "prediction": scene.prediction})

    rate_hz = report.frame_rate_hz / step
    write_depth_film(folder / FILM_FILE, frames(), rate_hz, (min(nears_m), max(fars_m)))
