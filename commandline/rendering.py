"""The commands of ``night-render``, but for those that draw (`commandline.scene_pictures`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from commandline.confirmation import YES, confirm_deletion
from commandline.endings import DefaultGroup
from commandline.options import FOLDER, ONLY, RENDER_RUN, RENDER_SETTINGS, Megahertz, chosen_scenes
from commandline.results import JSON, tell
from commandline.scene_pictures import PICTURE_COMMANDS
from commandline.streams import say
from disk.counted import counted
from processes import showing_progress
from scenegen import Dataset, open_dataset

if TYPE_CHECKING:
    from render import RenderSettings, RunOptions


@click.group(cls=DefaultGroup, default="render")
def night_render() -> None:
    """Render what the camera measures of every scene in DATASET, or work on what is rendered.

    What is rendered is kept; an interrupted run goes on when it is started again, on one machine or several.
    Settings that are not given are those the dataset was rendered with before. If the folder of a
    dataset has the name of a command, such as status, write ./status.
    """


@night_render.command(short_help="Render DATASET; the word may be left out.")
@click.argument("dataset", type=FOLDER)
@RENDER_SETTINGS
@ONLY
@RENDER_RUN
@click.option("--dry-run", is_flag=True, help="Print the plan, and render nothing.")
@JSON
def render(dataset: Path, only: tuple[str, ...], dry_run: bool, as_json: bool, **given: Any) -> None:
    """Render what the camera measures of every scene in DATASET; this word may be left out."""
    from render.farm.run import plan_run, render_dataset

    opened = open_dataset(dataset)
    settings, options = _chosen_run(opened, given)
    ids = chosen_scenes(opened, only)
    if dry_run:
        planned = plan_run(opened, settings, ids, options, say if as_json else click.echo)
        if as_json:
            tell([], planned.as_data(opened, settings), as_json)
        return
    result = render_dataset(opened, settings, ids, options, say)
    tell(result.sentences(opened.renders), result.as_data(opened, settings), as_json)
    if complaints := result.complaints(opened.renders):
        say("\n".join(complaints))
        raise click.exceptions.Exit(1)


@night_render.command(short_help="How far DATASET is rendered.")
@click.argument("dataset", type=FOLDER)
@RENDER_SETTINGS
@ONLY
@JSON
def status(dataset: Path, only: tuple[str, ...], as_json: bool, **given: Any) -> None:
    """Say how far DATASET is rendered, what failed and how long the rest will take."""
    from render import read_status

    opened = open_dataset(dataset)
    found = read_status(opened, _settings(opened, given), chosen_scenes(opened, only))
    tell(found.sentences(), found.as_data(), as_json)


@night_render.command(short_help="Check every rendered file.")
@click.argument("dataset", type=FOLDER)
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes.")
@ONLY
@JSON
def verify(dataset: Path, workers: int, only: tuple[str, ...], as_json: bool) -> None:
    """Check every rendered file of DATASET; bad scenes are rendered in the next run."""
    from render import verify as check

    opened = open_dataset(dataset)
    with showing_progress(None, "scene", "verify") as bar:
        report = check(opened, chosen_scenes(opened, only), workers=workers, on_scene=bar.update)
    tell(report.sentences(), report.as_data(), as_json)
    if report.damaged_scenes:
        say(f"night-gen scenes {dataset} repairs scene files")
    if report.renders_again:
        say("the next night-render renders the bad ones again")
    if report.problems or report.damaged_scenes:
        raise click.exceptions.Exit(1)


for each in PICTURE_COMMANDS:
    night_render.add_command(each)


@night_render.command(short_help="Transients in another form.")
@click.argument("dataset", type=FOLDER)
@click.option("--to", "form", required=True, type=click.Choice(["itof", "tal"]), help="Form of the files.")
@click.option("--out", required=True, type=FOLDER, help="Folder to write to.")
@click.option("--frequencies", type=Megahertz(), help="Of --to itof, instead of the dataset's.")
@ONLY
def convert(dataset: Path, form: str, out: Path, frequencies: Any, only: tuple[str, ...]) -> None:
    """Write transients of DATASET in another form: phasors at any frequencies, or HDF5 for y-tal."""
    from render import convert_to_itof, export_tal

    if frequencies and form == "tal":
        raise click.UsageError("--frequencies goes with --to itof: a capture for y-tal holds all time bins")
    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only)
    with showing_progress(len(ids), "scene", "convert") as bar:
        for scene_id in ids:
            if form == "tal":
                export_tal(opened, scene_id, out / f"{scene_id}.hdf5")
            else:
                convert_to_itof(opened, scene_id, out, frequencies)
            bar.update()
    click.echo(f"{counted(len(ids), 'scene')} converted in {out}")


@night_render.command("export", short_help="All of DATASET in one HDF5 or Zarr file.")
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, metavar="FILE", help="New .h5 file, or .zarr folder.")
@click.option(
    "--partial", is_flag=True, help="Leave out scenes that are not rendered or not good, and name them."
)
@JSON
def export_dataset(dataset: Path, out: Path, partial: bool, as_json: bool) -> None:
    """Write phasors, ground truth, parameters, splits and provenance of DATASET into one HDF5 file.

    With a name that ends in .zarr, into one Zarr folder with the same arrays.
    """
    from render import export_dataset as write

    opened = open_dataset(dataset)
    with showing_progress(len(opened.ids()), "scene", "export") as bar:
        written = write(opened, out, partial=partial, on_scene=bar.update)
    tell(written.sentences(), written.as_data(), as_json)


@night_render.command(short_help="Delete transients, keep phasors.")
@click.argument("dataset", type=FOLDER)
@ONLY
@YES
def drop_transients(dataset: Path, only: tuple[str, ...], yes: bool) -> None:
    """Delete the transients of DATASET and keep phasors and ground truth; only rendering brings them back."""
    from disk.byte_size import size
    from render.products.transient_deletion import delete_transients, transient_bytes

    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only)
    found = size(transient_bytes(opened, ids))
    chosen = counted(len(ids), "scene")
    confirm_deletion(f"the transients of {chosen}, {found}, which only rendering brings back", yes)
    with showing_progress(len(ids), "scene", "check") as bar:
        freed = delete_transients(opened, ids, bar.update)
    click.echo(f"{size(freed)} freed: the transients of {chosen} are deleted")


def _settings(dataset: Dataset, options: Mapping[str, Any]) -> RenderSettings:
    """Settings of before, changed by the options that are given."""
    from render import settings_for

    return settings_for(dataset, {name: value for name, value in options.items() if value is not None})


def _chosen_run(dataset: Dataset, options: dict[str, Any]) -> tuple[RenderSettings, RunOptions]:
    """How to render, and the options of the run that change no pixel."""
    from render import RunOptions

    workers, where = options.pop("workers"), options.pop("cluster")
    again, accepted = options.pop("again"), options.pop("accept")
    is_running = where is not None and ("://" in where or not where)  # an empty one is no file, either
    run_options = RunOptions(
        workers=workers,
        scheduler=where if is_running else None,
        cluster_file=Path(where) if where is not None and not is_running else None,
        retry_failed="failed" in again,
        replace="changed" in again,
        ignore_space="small-disk" in accepted,
    )
    options |= {"accept_edited": "edited" in accepted, "accept_lost_light": "lost-light" in accepted}
    return _settings(dataset, options), run_options
