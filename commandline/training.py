"""The command ``night-train``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from commandline.endings import NightCommand
from commandline.options import FOLDER, TRAINING
from commandline.results import JSON, tell
from scenegen import open_dataset
from storage import PresetError

if TYPE_CHECKING:
    from model import TrainSettings


@click.command(cls=NightCommand)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Run folder to write.")
@click.option(
    "--preset", help="Settings: a name in data/training, or a .toml file.  [default for a new run: default]"
)
@click.option("--resume", is_flag=True, help="Go on with the run in --out, by its own settings.")
@click.option(
    "--from",
    "start_from",
    type=FOLDER,
    metavar="RUN",
    help="Start from the best weights of this run, with its network, input, readout, loss and optimiser "
    "(fine-tuning).",
)
@TRAINING
@JSON
def night_train(
    dataset: Path, out: Path, resume: bool, start_from: Path | None, as_json: bool, **options: Any
) -> None:
    """Train a network on the renders of DATASET; options override the preset.

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
    result = model.train(opened, out, settings, resume=resume, start_from=start_from)
    if is_first_process():
        tell([result.sentence(out)], {"run": str(out), **asdict(result)}, as_json)


def _chosen_settings(
    out: Path, resume: bool, start_from: Path | None, preset: str | None, **options: Any
) -> TrainSettings:
    """Settings of the run in `out` if it is resumed, then those of the preset, then the given options.

    A run that starts from another one has the network, the input, the readout, the loss and the optimiser of
    that one, not those of the preset.
    """
    import model
    from model.idle_settings import idle_settings

    before = model.run_settings(out) if resume else {}
    named = preset or (None if resume else "default")
    data, origin = model.training_preset(named) if named else ({}, "options")
    given = {name: value for name, value in options.items() if value is not None}
    if "sensor" in given:
        given["sensor"] = asdict(given["sensor"])
    inherited = model.fine_tuning_settings(start_from) if start_from is not None else {}
    without = before | data | inherited
    try:
        settings = model.settings_from_dict(without | given, origin)
    except PresetError:
        model.settings_from_dict(without, origin)  # its own fault, if it has one
        settings = model.settings_from_dict(without | given, "options")
    idle = idle_settings(settings.target, settings.channels)
    for name in sorted(given.keys() & idle.keys()):
        if given[name] != without.get(name):
            option = name.replace("_", "-")
            raise click.UsageError(f"--{option} changes nothing with {idle[name]}: leave it out")
    return settings
