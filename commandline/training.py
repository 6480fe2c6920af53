"""The command ``night-train``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from commandline.endings import NightCommand
from commandline.networks_of_presets import BUDGET_S, make_network
from commandline.options import FOLDER, Duration, Number, option
from commandline.results import JSON, tell
from commandline.streams import say
from commandline.training_options import SET, TRAINING, given_settings
from disk import PresetError, read_settings
from model.settings.fine_tuning import fine_tuning_course
from model.settings.keys import merged
from scenegen import Preset, open_dataset, preset_from_dict

if TYPE_CHECKING:
    from model import TrainSettings
    from scenegen.making.meshes import UserMesh
    from scenegen.shapes import Shape

_OF_A_NETWORK: Final = ("input", "network", "target")  # settings that a network to start from decides


@click.command(cls=NightCommand)
@click.argument("dataset", type=FOLDER, required=False)
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
@click.option(
    "--for",
    "wanted_for",
    metavar="PRESET",
    help="Instead of DATASET: make one in OUT-scenes, train on fresh scenes of this preset, from the nearest "
    "network that comes with NIGHT, and judge in OUT-report. Or a capture of the empty corner, with --gap.",
)
@click.option(
    "--gap",
    "gap_m",
    type=Number(0.01, 100),
    metavar="METRES",
    help="With --for and a capture: from the relay wall to the middle wall, which no capture shows.",
)
@click.option(
    "--budget", "budget_s", type=Duration(), help="With --for: time of the training.  [default: 30min]"
)
@JSON
@option("Settings", "--preset", help="Settings of a name in data/training, or of a .toml file.")
@SET
@TRAINING
def night_train(
    dataset: Path | None,
    out: Path,
    resume: bool,
    start_from: Path | None,
    fresh: str | None,
    wanted_for: str | None,
    gap_m: float | None,
    budget_s: float | None,
    as_json: bool,
    preset: str | None,
    assignments: tuple[str, ...],
    **options: Any,
) -> None:
    """Train a network on the renders of DATASET, or for the scenes of a preset.

    Ctrl-C and SIGTERM leave a checkpoint that --resume goes on from. On several GPUs:

    \b
    torchrun --nproc-per-node 4 $(which night-train) DATASET --out RUN
    """  # noqa: D301
    import model
    from model.training.processes import is_first_process

    if resume and start_from is not None:
        raise click.UsageError("--from begins a new run, and --resume goes on with one: leave one out")
    data, origin = model.training_preset(preset) if preset else ({}, "options")
    chosen = data, origin, given_settings(options, assignments)
    if wanted_for is not None:
        _refuse_mixed(dataset, fresh)
        found = _corner_of_capture(wanted_for, gap_m) or _preset_of_scenes(wanted_for)
        _train_for(wanted_for, found, out, resume, start_from, budget_s, chosen, as_json)
        return
    if dataset is None or budget_s is not None or gap_m is not None:
        own = "--budget" if gap_m is None else "--gap"
        raise click.UsageError(f"{own} goes with --for" if dataset else "give DATASET, or --for PRESET")
    opened = open_dataset(dataset)
    before = model.run_settings(out) if resume else {}
    inherited = model.fine_tuning_settings(start_from) if start_from is not None else {}
    settings = _settings(before, inherited, *chosen)
    if start_from is not None and not fresh:
        settings = _settings(fine_tuning_course(settings, len(opened.ids("train"))), inherited, *chosen)
    given, meshes, _ = _preset_of_scenes(fresh) if fresh else (None, None, None)
    result = model.train(
        *(opened, out, settings), resume=resume, start_from=start_from, fresh=given, meshes=meshes
    )
    if is_first_process():
        tell([result.sentence(out)], {"run": str(out), **asdict(result)}, as_json)


def _refuse_mixed(dataset: Path | None, fresh: str | None) -> None:
    """Refuse what does not go with --for."""
    if dataset is not None or fresh is not None:
        other = "--fresh" if fresh is not None else "DATASET"
        raise click.UsageError(f"--for makes a dataset and trains on fresh scenes: leave {other} out")
    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise click.UsageError("--for works in one process: for torchrun, give its dataset and --fresh")


def _budget_s(budget_s: float | None, chosen: Mapping[str, Any], resume: bool) -> float | None:
    """The time of a training with --for; None if settings say how long it is.

    Parameters
    ----------
    chosen : settings of the run that the user gives.
    """
    if resume and budget_s is not None:
        raise click.UsageError("the run has its length already: --max-epochs makes it longer, not --budget")
    if resume or "max_epochs" in chosen:
        if budget_s is not None:
            raise click.UsageError("--budget and run.max_epochs both say how long to train: leave one out")
        return None
    if own := sorted({"epoch_scenes", "patience"} & {*chosen}):
        names = " and ".join(f"run.{each}" for each in own)
        raise click.UsageError(f"the time of --for decides {names}: give --max-epochs, too, or leave it out")
    return BUDGET_S if budget_s is None else budget_s


def _train_for(
    name: str,
    scenes: tuple[Preset, dict[Shape, UserMesh], Path],
    out: Path,
    resume: bool,
    start_from: Path | None,
    budget_s: float | None,
    chosen: tuple[dict[str, Any], str, dict[str, Any]],
    as_json: bool,
) -> None:
    """Train for `scenes`: a preset, the meshes that it names, and the folder of its file, called `name`."""
    import model
    from model.run_folder.run_config import CONFIG_FILE
    from model.training.nearest import nearest_network

    preset, meshes, folder = scenes
    data, _, given = chosen
    resume = resume and (out / CONFIG_FILE).is_file()  # it may have been interrupted before the training
    budget_s = _budget_s(budget_s, merged(data, given).get("run", {}), resume)
    before: dict[str, Any] = {}
    inherited: dict[str, Any] = {}
    why = f"the training starts from {start_from}"
    if resume:
        before = model.run_settings(out)
    else:
        has_sensor = _settings({}, {}, *chosen).augmentation.camera is not None
        if not preset.is_one_corner:
            before = {"input": {"channels": {"kind": "residual+wall+rays"}}}
        if has_sensor:  # the waves of a real one change the phases by more than the hidden light does
            before |= {"augmentation": {"camera": {"empty_corner": True}}}
        own = sorted({*_OF_A_NETWORK} & {*data, *given})
        if start_from is None and own:
            why = f"the training starts from new weights, because options give {' and '.join(own)}"
        elif start_from is None:
            nearest = nearest_network(preset, has_sensor=has_sensor)
            start_from, why = nearest.run, nearest.why
            frequencies = {"frequencies_hz": list(nearest.frequencies_hz)}
            inherited = {"network": {"block": nearest.block}, "input": frequencies} if start_from else {}
        if start_from is not None:
            inherited = merged(model.fine_tuning_settings(start_from), inherited)
    settings = _settings(before, inherited, *chosen)
    make_network(
        *(name, preset, meshes, folder, out, resume, start_from, budget_s, settings, why, as_json),
    )


def _preset_of_scenes(name_or_file: str) -> tuple[Preset, dict[Shape, UserMesh], Path]:
    """A preset of scenes, the mesh files that it names, and their folder."""
    from scenegen.corner_check import refuse_impossible_corner
    from scenegen.making.meshes import with_meshes

    data, origin = read_settings("presets", name_or_file)
    preset = preset_from_dict(data, origin)
    preset, meshes = with_meshes(preset, Path(origin).parent)
    refuse_impossible_corner(preset, meshes)
    return preset, meshes, Path(origin).parent


def _corner_of_capture(name: str, gap_m: float | None) -> tuple[Preset, dict[Shape, UserMesh], Path] | None:
    """The same for the corner whose empty wall a measurement file shows; None for a preset."""
    from itof.files.measurement_writing import ENDINGS
    from render.pairs.captured_corner import captured_corner
    from scenegen.corner_check import refuse_impossible_corner

    if not name.lower().endswith(ENDINGS):
        if gap_m is not None:
            raise click.UsageError(
                f"--gap is for an imported capture ({', '.join(ENDINGS)}): a preset has middle_wall, and raw "
                f"frames need night-eval capture import {name} --sidecar FILE --out OUT.npz"
            )
        return None
    by_hand = f"night-eval capture corner {name} --out FILE.toml"
    if gap_m is None:
        raise click.UsageError(
            f"{name} shows neither the middle wall nor the hidden region: give --gap METRES, from the relay "
            f"wall to the middle wall, for the paper's hidden region behind it; or change both in the preset "
            f"that {by_hand} writes, and give that to --for"
        )
    corner = captured_corner(name, gap_m=gap_m)
    if corner.doubts:
        raise click.UsageError(
            f"the place of the wall in {name} is not certain: {'; '.join(corner.doubts)}; if you know "
            f"better, give --for the preset that {by_hand} --force writes"
        )
    for sentence in corner.sentences:
        say(sentence)
    refuse_impossible_corner(corner.preset)
    return corner.preset, {}, Path(name).parent


def _settings(
    before: Mapping[str, Any],
    inherited: Mapping[str, Any],
    preset: dict[str, Any],
    origin: str,
    given: dict[str, Any],
) -> TrainSettings:
    """The defaults or the settings `before`, changed by a preset of settings, then by the options.

    A run that starts from another one has the input, the network, the target and the algorithm of that one
    (`inherited`), not those of the preset.
    """
    import model

    without = merged(merged(before, preset), inherited)
    try:
        return model.settings_from_dict(merged(without, given), origin)
    except PresetError:
        model.settings_from_dict(without, origin)  # its own fault, if it has one
        return model.settings_from_dict(merged(without, given), "options")
