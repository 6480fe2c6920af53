"""``night-train --for``: scenes of a preset, a network for them and a report, by what other commands do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from commandline.results import tell
from commandline.streams import say
from disk.extras import need
from scenegen import Dataset, Preset
from scenegen.preset import DatasetSettings

if TYPE_CHECKING:
    from model import TrainSettings
    from model.training.budget import Speed
    from scenegen.making.meshes import UserMesh
    from scenegen.shapes import Shape

BUDGET_S: Final = 1800.0
_EXPOSURES: Final = (1, 100)  # by which a network for a camera is judged, on the first test scenes
_EXPOSED: Final = 32
# Scenes that scale the input, judge each epoch, and test the network: a third each.
_SCENES: Final = DatasetSettings(count=384, test_fraction=1 / 3, validation_fraction=1 / 2)
_ERROR: Final = 0.02  # of their hidden light; 0.01 takes a mesh of many parts three times as long


def make_network(
    name: str,
    preset: Preset,
    meshes: Mapping[Shape, UserMesh],
    mesh_folder: Path,
    out: Path,
    resume: bool,
    start_from: Path | None,
    budget_s: float | None,
    settings: TrainSettings,
    why: str,
    as_json: bool,
) -> None:
    """Make the scenes, train and judge; what is there of an interrupted command is kept.

    Parameters
    ----------
    name : of the preset, for sentences.
    budget_s : of the training, seconds; None if `settings` say how long.
    why : what the training starts from, as a sentence without a full stop.
    """
    import model
    from disk.own_files import refuse_other_files
    from model.judging.exposure_results import files_of_exposures
    from model.judging.refusals import EvaluationError, refuse_other_contents
    from model.settings.fresh import FreshScenes
    from model.training.refusals import refuse_other_run, refuse_preset

    need("report", ("jinja2", "plotly"), "the report of night-train --for")
    place = out.resolve()
    if not place.name:
        raise click.BadParameter(f"{out} has no name for the folders beside it", param_hint="--out")
    data, report = (place.with_name(f"{place.name}-{part}") for part in ("scenes", "report"))
    refuse_other_run(out, resume)
    camera = settings.augmentation.camera
    if camera is None:
        refuse_other_contents(report)
    else:
        refuse_other_files(report, files_of_exposures, "judgement of exposures", EvaluationError)
    refuse_preset(FreshScenes.of(preset, meshes), name, settings, meshes)
    show: Callable[[str], object] = say if as_json else click.echo
    dataset = _rendered(data, preset, mesh_folder, settings)
    given: dict[str, Any] = {"fresh": preset, "meshes": meshes, "start_from": start_from}
    if not resume:
        settings = _planned(dataset, settings, budget_s, given, why, show)
    result = model.train(dataset, out, settings, resume=resume, **given)
    show(result.sentence(out))
    folders = {"run": str(out), "dataset": str(data), "report": str(report)}
    tell(_judged(dataset, out, report, settings), folders, as_json)


def _rendered(data: Path, preset: Preset, mesh_folder: Path, settings: TrainSettings) -> Dataset:
    """The dataset that scales and judges, whole."""
    from render import RunOptions, render_dataset, settings_for
    from scenegen import make_dataset, open_dataset

    shown, scenes = settings.run.progress, replace(_SCENES, seed=preset.dataset.seed)
    judging = replace(preset, dataset=scenes)
    if (data / "dataset.json").is_file() and open_dataset(data).preset != judging:
        raise click.UsageError(f"{data} holds scenes of another preset: remove it, or choose another --out")
    dataset = make_dataset(data, judging, mesh_folder=mesh_folder, progress=shown)
    given = {"product": "itof", "method": "batched", "error": _ERROR, "device": settings.run.device}
    how = settings_for(dataset, given)
    result = render_dataset(dataset, how, dataset.ids(), RunOptions(progress=shown), say)
    if complaints := result.complaints(dataset.renders):
        say("\n".join(complaints))
        raise click.exceptions.Exit(1)
    return dataset


def _planned(
    dataset: Dataset,
    settings: TrainSettings,
    budget_s: float | None,
    given: Mapping[str, Any],
    why: str,
    show: Callable[[str], object],
) -> TrainSettings:
    """The settings with the epochs that the budget gives; says what to expect of them."""
    from model.training.budget import measured_speed
    from model.training.camera_light import camera_light

    if settings.run.progress:
        say("measuring how fast the training is")
    speed = measured_speed(dataset, settings, **given)
    if budget_s is not None:
        epochs, scenes = speed.epochs_in(budget_s)
        run = replace(settings.run, max_epochs=epochs, patience=epochs, epoch_scenes=scenes)
        settings = replace(settings, run=run)
    found = "" if speed.start_cm is None else f"; before the training, it has {speed.start_cm:.1f} cm here"
    show(f"{why}{found}")
    show(_course(settings, speed))
    camera = settings.augmentation.camera
    if camera is None:
        show(_expected(settings, speed, one_corner=dataset.preset.is_one_corner))
    else:
        light = camera_light(dataset, camera.sensor).sentence
        show(f"{light}; no object: {speed.no_object_cm:.1f} cm; nobody has measured what error is left")
    return settings


def _judged(dataset: Dataset, run: Path, report: Path, settings: TrainSettings) -> list[str]:
    """The report on the test scenes, which the camera of the settings measures if there is one."""
    import model

    camera, device, progress = settings.augmentation.camera, settings.run.device, settings.run.progress
    if camera is not None:
        captures = max(_EXPOSURES) if camera.empty_corner else 0
        found = model.judge_exposures(
            *(run, dataset, report, camera.sensor),
            exposures=_EXPOSURES,
            corner_exposures=captures,
            first=_EXPOSED,
            device=device,
            progress=progress,
        )
        return [found.table, f"all numbers in {report}"]
    judged = model.evaluate(run, dataset, report, device=device, progress=progress)
    for warning in judged.warnings:
        say(f"warning: {warning}")
    return [judged.table, f"look at {report / 'index.html'}"]


def _expected(settings: TrainSettings, speed: Speed, *, one_corner: bool) -> str:
    """What error to expect, and after twice the time."""
    from model.training.expectation import expected_mae_cm

    samples = settings.run.max_epochs * settings.run.epoch_scenes
    no_object = f"no object: {speed.no_object_cm:.1f} cm"
    once, twice = (
        expected_mae_cm(times * samples, speed.no_object_cm, one_corner=one_corner, start_cm=speed.start_cm)
        for times in (1, 2)
    )
    if once is None or twice is None:
        return f"nobody has measured what error so few samples leave ({no_object})"
    return (
        f"expect an MAE of about {once:.1f} cm, and {twice:.1f} cm after twice the time, as measured at "
        f"40x30 pixels ({no_object})"
    )


def _course(settings: TrainSettings, speed: Speed) -> str:
    """How many samples the training has, and how long it takes."""
    epochs, scenes = settings.run.max_epochs, settings.run.epoch_scenes
    seconds = speed.seconds(epochs, scenes)
    time = f"{seconds / 60:.0f} minutes" if seconds >= 120 else f"{seconds:.0f} seconds"
    return (
        f"{epochs * scenes} samples in about {time}, {speed.scenes_per_s:.0f} a second (--max-epochs "
        f"{epochs} --set run.epoch_scenes={scenes} repeats it, however fast the machine is)"
    )
