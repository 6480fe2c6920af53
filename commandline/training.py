"""The command ``night-train``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from commandline.endings import NightCommand
from commandline.options import FOLDER, option
from commandline.results import JSON, tell
from commandline.training_options import SET, TRAINING, given_settings
from disk import PresetError, read_settings
from model.settings.keys import merged
from scenegen import Preset, open_dataset, preset_from_dict

if TYPE_CHECKING:
    from model import TrainSettings
    from scenegen.making.meshes import UserMesh
    from scenegen.shapes import Shape


@click.command(cls=NightCommand)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Run folder to write.")
@click.option("--resume", is_flag=True, help="Go on with the run in --out, by its own settings.")
@click.option(
    "--from",
    "start_from",
    type=FOLDER,
    metavar="RUN",
    help="Fine-tuning: start from the best weights of this run, with its input, network, target and "
    "algorithm.",
)
@click.option(
    "--fresh",
    metavar="PRESET",
    help="Train on new scenes of this preset of scenes, rendered meanwhile; DATASET scales the input and "
    "judges.",
)
@JSON
@option("Settings", "--preset", help="Settings of a name in data/training, or of a .toml file.")
@SET
@TRAINING
def night_train(
    dataset: Path,
    out: Path,
    resume: bool,
    start_from: Path | None,
    fresh: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Train a network on the renders of DATASET.

    Ctrl-C and SIGTERM leave a checkpoint that --resume goes on from. On several GPUs:

    \b
    torchrun --nproc-per-node 4 $(which night-train) DATASET --out RUN
    """  # noqa: D301
    import model
    from model.training.processes import is_first_process

    if resume and start_from is not None:
        raise click.UsageError("--from begins a new run, and --resume goes on with one: leave one out")
    opened = open_dataset(dataset)
    settings = _chosen_settings(out, resume, start_from, **options)
    preset, meshes = _fresh_preset(fresh) if fresh else (None, None)
    result = model.train(
        *(opened, out, settings), resume=resume, start_from=start_from, fresh=preset, meshes=meshes
    )
    if is_first_process():
        tell([result.sentence(out)], {"run": str(out), **asdict(result)}, as_json)


def _fresh_preset(name_or_file: str) -> tuple[Preset, dict[Shape, UserMesh]]:
    """A preset of scenes, and the mesh files that it names."""
    from scenegen.corner_check import refuse_impossible_corner
    from scenegen.making.meshes import with_meshes

    data, origin = read_settings("presets", name_or_file)
    preset = preset_from_dict(data, origin)
    preset, meshes = with_meshes(preset, Path(origin).parent)
    refuse_impossible_corner(preset, meshes)
    return preset, meshes


def _chosen_settings(
    out: Path,
    resume: bool,
    start_from: Path | None,
    preset: str | None,
    assignments: tuple[str, ...],
    **options: Any,
) -> TrainSettings:
    """The defaults or the settings of the run in `out`, changed by the preset, then by the options.

    A run that starts from another one has the input, the network, the target and the algorithm of that one,
    not those of the preset.
    """
    import model

    before = model.run_settings(out) if resume else {}
    data, origin = model.training_preset(preset) if preset else ({}, "options")
    inherited = model.fine_tuning_settings(start_from) if start_from is not None else {}
    without, given = merged(merged(before, data), inherited), given_settings(options, assignments)
    try:
        return model.settings_from_dict(merged(without, given), origin)
    except PresetError:
        model.settings_from_dict(without, origin)  # its own fault, if it has one
        return model.settings_from_dict(merged(without, given), "options")
