"""The commands ``night-eval judge`` and ``night-eval refine``."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, TypeVar

import click

from commandline.endings import NightCommand
from commandline.options import COUNT, DEVICE, FOLDER, MASK_FROM, MASK_THRESHOLD, Counts, Sensor
from commandline.results import JSON, tell
from model.refinement.settings import LARGEST_DIFFERENCE, LARGEST_MISFIT, UNKNOWNS
from scenegen import load_preset, open_dataset

_OF_THE_REPORT = ("scenes", "mask_from", "mask_threshold")
_OF_THE_CAMERA = ("exposures", "corner_exposures", "each_imperfection", "first")
_Command = TypeVar("_Command", bound=Callable[..., Any])


def _split(words: str) -> Callable[[_Command], _Command]:
    """The option that names the scenes to work on."""
    splits = click.Choice(["train", "validation", "test"])
    return click.option("--split", type=splits, default="test", show_default=True, help=words)


@click.command(
    "judge", cls=NightCommand, short_help="Compare with the ground truth; the word may be left out."
)
@click.argument("run", type=FOLDER)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Report folder to write.")
@_split("Scenes to judge by.")
@click.option(
    "--scene",
    "scenes",
    multiple=True,
    metavar="ID",
    help="Show this scene in the figures of several scenes; may be repeated.  [default: five, spread by "
    "accuracy]",
)
@MASK_FROM
@MASK_THRESHOLD
@click.option(
    "--sensor",
    type=Sensor(),
    help="Let this camera measure the scenes: a name in data/sensors, or a .toml file. OUT then holds the "
    "error at each exposure instead of the report.",
)
@click.option("--exposures", type=Counts(), help="With --sensor: exposures that are averaged.  [default: 1]")
@click.option(
    "--corner-exposures",
    type=click.IntRange(0, 1_000_000),
    help="With --sensor: averaged exposures of the empty corner, as reference.  [default: no capture]",
)
@click.option(
    "--each-imperfection",
    is_flag=True,
    default=None,
    help="With --sensor: each imperfection of the camera alone, and all but it; at one number of exposures.",
)
@click.option("--first", type=COUNT, help="With --sensor: judge the first so many scenes only.")
@DEVICE
@JSON
def judge(run: Path, dataset: Path, out: Path, as_json: bool, sensor: Any, **options: Any) -> None:
    """Judge the network of RUN against the ground truth of DATASET; this word may be left out."""
    import model

    given = {name: value for name, value in options.items() if value not in (None, ())}
    _refuse_mixed(given, behind_camera=sensor is not None)
    if sensor is not None:
        numbers = out.resolve() / "exposures.json"  # the folder "." is another one afterwards
        found = model.judge_exposures(run, open_dataset(dataset), out, sensor, **given)
        tell([found.table, f"all numbers in {out}"], numbers, as_json)
        return
    metrics = out.resolve() / "metrics.json"
    report = model.evaluate(run, open_dataset(dataset), out, **given)
    look = f"look at {out / 'index.html'}; figures and point clouds are beside it"
    tell([report.table, look], metrics, as_json)


def _refuse_mixed(given: Collection[str], *, behind_camera: bool) -> None:
    """Refuse options of the report together with a camera, and those of the camera without one."""
    wrong = sorted(set(given) & set(_OF_THE_REPORT if behind_camera else _OF_THE_CAMERA))
    if not wrong:
        return
    names = ", ".join(f"--{name.removesuffix('s') if name == 'scenes' else name}" for name in wrong)
    names = names.replace("_", "-")
    if behind_camera:
        raise click.UsageError(f"{names}: for the report, which --sensor does not write; leave it out")
    raise click.UsageError(f"{names}: for a camera; name one with --sensor")


@click.command("refine", cls=NightCommand, short_help="Find the solid that explains each measurement.")
@click.argument("run", type=FOLDER)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Folder to write; a started one is continued.")
@_split("Scenes to refine.")
@click.option(
    "--objects",
    metavar="PRESET",
    help="Which solids may be there, of which sizes and reflectance: those of this preset, a name in "
    "data/presets or a .toml file.  [default: those of the dataset]",
)
@click.option(
    "--unknown",
    multiple=True,
    type=click.Choice(UNKNOWNS),
    help="Fit this, too, instead of taking the preset's; may be repeated.",
)
@click.option(
    "--largest-misfit",
    type=float,
    default=LARGEST_MISFIT,
    show_default=True,
    help="Share of the hidden light that an accepted fit may leave unexplained.",
)
@click.option(
    "--largest-difference",
    type=float,
    default=LARGEST_DIFFERENCE,
    show_default=True,
    help="Largest mean difference of an accepted fit to the network's depth map, as a multiple of the MAE "
    "that the network expects. It counts where noise, or light left unexplained, is more than 1 % of the "
    "hidden light (or than --largest-misfit, if that is less).",
)
@click.option("--workers", type=COUNT, default=1, show_default=True, help="Processes that share the scenes.")
@DEVICE
@JSON
def refine(run: Path, dataset: Path, out: Path, as_json: bool, objects: str | None, **options: Any) -> None:
    """Refine the depth maps of RUN by rendering, and compare before and after with DATASET.

    For each scene, a box, sphere, cylinder, cone or bent sheet is moved until its three-bounce light is the
    measured one, from where the depth map of the network shows it. Where no solid is accepted, the depth map
    stays as it is.
    """
    import model

    preset = None if objects is None else load_preset(objects)
    report = model.refine_split(run, open_dataset(dataset), out, objects=preset, **options)
    look = f"depth maps and solids in {out / 'scenes'}"
    tell([report.table, report.sentence, look], out.resolve() / "refined.json", as_json)
