"""The four commands: ``night-gen``, ``night-render``, ``night-train``, ``night-eval``.

Importing this file loads neither torch nor Mitsuba nor Blender: each command imports what it needs when it
runs. What the commands share is in `commandline`: how they end, and their options.
"""

from __future__ import annotations

import functools
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from commandline.captures import capture
from commandline.confirmation import YES, confirm_deletion
from commandline.dataset_export import export_dataset
from commandline.endings import DefaultGroup, NightGroup, noted_interrupt
from commandline.evaluation import judge, refine
from commandline.options import (
    DEVICE,
    FOLDER,
    FORCE,
    FOV,
    ONLY,
    PRESET,
    RENDER_RUN,
    RENDER_SETTINGS,
    RESCALE,
    Megahertz,
    chosen_scenes,
    overridden_preset,
)
from commandline.rendering import chosen_run, render_settings
from commandline.results import JSON, tell
from commandline.scene_pictures import PICTURE_COMMANDS
from commandline.streams import say
from commandline.training import night_train
from scenegen import leaks, open_dataset
from scenegen.progress import showing_progress

__all__ = ["night_eval", "night_gen", "night_render", "night_train"]


@click.group(cls=NightGroup)
def night_gen() -> None:
    """Make look-behind-a-corner scenes in Blender."""


@night_gen.command(short_help="Make the scenes of a preset.")
@click.argument("out", type=FOLDER)
@PRESET
@click.option("--count", type=int, help="Number of scenes instead of the preset's.")
@click.option("--seed", type=int, help="Seed instead of the preset's.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Processes that make scenes, 350 MB each; the dataset is the same.",
)
def scenes(out: Path, preset: str | None, count: int | None, seed: int | None, workers: int) -> None:
    """Make the scenes of a preset in the folder OUT; a larger --count than before adds scenes.

    Damaged scenes are made again. A dataset in OUT brings its own preset.
    """
    from scenegen.making.datasets import blender_maker
    from scenegen.making.depth_range import refuse_wrapping_depths
    from scenegen.making.generation import generate
    from scenegen.making.generation_pool import generate_in_processes
    from scenegen.making.meshes import read_meshes
    from scenegen.making.target import check_target

    settings, preset_folder = overridden_preset(out, preset, count, seed)
    meshes = read_meshes(settings, preset_folder)
    refuse_wrapping_depths(settings, meshes)
    hashes = {shape: mesh.sha256 for shape, mesh in meshes.items()}
    check_target(out, settings, hashes)  # before Blender, which takes a second to load
    make_maker = functools.partial(blender_maker, meshes)
    with showing_progress(settings.dataset.count, "scene", "scenes") as bar:
        if workers == 1:
            dataset = generate(out, settings, make_maker(), bar.update, meshes=hashes)
        else:
            dataset = generate_in_processes(
                out, settings, make_maker, bar.update, workers=workers, meshes=hashes
            )
    found = leaks(dataset.scene(scene_id) for scene_id in dataset.ids())
    if found:
        say(f"warning: the splits leak in {len(found)} places, for example: {found[0]}")
    click.echo(dataset.sentence())


@night_gen.command(short_help="Contact sheet, plots and card of a dataset.")
@click.argument("dataset", type=FOLDER)
@click.option(
    "--count",
    type=click.IntRange(1, 100),
    default=12,
    show_default=True,
    help="Scenes on the contact sheet, even over classes and splits.",
)
@click.option("--only", multiple=True, metavar="ID", help="Only this scene on the sheet; may be repeated.")
@click.option("--licence", metavar="TEXT", help="Licence of the dataset, for its card; kept from then on.")
def preview(dataset: Path, count: int, only: tuple[str, ...], licence: str | None) -> None:
    """Draw a contact sheet and plots of DATASET, and write its card, README.md."""
    from render.products import contact_sheet
    from render.products import preview as preview_files
    from scenegen.making.datasets import blender_maker

    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only) if only else contact_sheet.choose_scenes(opened, count)
    preview_files.check_preview(opened, ids, licence)  # before Blender, which takes a second to load
    maker = blender_maker(preview_files.meshes_in(opened, ids))
    steps = len(opened.ids()) + len(ids)
    with noted_interrupt() as raise_noted, showing_progress(steps, "scene", "preview") as bar:

        def scene_done() -> None:
            bar.update()
            raise_noted()  # Blender loses an exception that comes while it renders

        written = preview_files.write_preview(opened, ids, maker.picture, licence, scene_done)
    for file in written:
        click.echo(f"{file}")
    if dataset / "README.md" not in written:
        say(f"{dataset / 'README.md'} is not ours and was left alone: rename it to get a dataset card")


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
    settings, options = chosen_run(opened, given)
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
    found = read_status(opened, render_settings(opened, given), chosen_scenes(opened, only))
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
    click.echo(f"{len(ids)} scenes converted in {out}")


night_render.add_command(export_dataset)


@night_render.command(short_help="Delete transients, keep phasors.")
@click.argument("dataset", type=FOLDER)
@ONLY
@YES
def drop_transients(dataset: Path, only: tuple[str, ...], yes: bool) -> None:
    """Delete the transients of DATASET and keep phasors and ground truth; only rendering brings them back."""
    from render.byte_size import size
    from render.products.transient_deletion import delete_transients, transient_bytes

    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only)
    found = size(transient_bytes(opened, ids))
    confirm_deletion(f"the transients of {len(ids)} scenes, {found}, which only rendering brings back", yes)
    with showing_progress(len(ids), "scene", "check") as bar:
        freed = delete_transients(opened, ids, bar.update)
    click.echo(f"{len(ids)} scenes have no transients now: {size(freed)} freed")


@click.group(cls=DefaultGroup, default="judge")
def night_eval() -> None:
    """Judge the network of RUN against the ground truth of DATASET, or use it.

    \b
    night-eval RUN DATASET --out REPORT       judge it (or: night-eval judge RUN DATASET ...)
    night-eval refine RUN DATASET --out DIR   find the solid that explains each measurement
    night-eval predict RUN INPUT --out DIR    depth maps of your own measurements
    night-eval export RUN --out MODEL.onnx    the network as an ONNX file
    night-eval capture import INPUT ...       measurements of the raw frames of a camera
    night-eval compact RUN --out DIR          the run at half its size, to publish
    """  # noqa: D301


night_eval.add_command(judge)
night_eval.add_command(refine)
night_eval.add_command(capture)


@night_eval.command(short_help="Depth maps of your own measurements.")
@click.argument("run", type=FOLDER)
@click.argument("measurement", metavar="INPUT", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Folder to write; an earlier prediction is replaced.")
@FOV
@RESCALE
@FORCE
@DEVICE
@JSON
def predict(
    run: Path,
    measurement: Path,
    out: Path,
    horizontal_fov_deg: float | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Predict depth maps from the measurements in INPUT by the network of RUN.

    INPUT is an itof.exr, or an .npz or .h5 file with `phasors` (H, W, F) or (N, H, W, F) complex,
    `frequencies_hz` (F) and, if there is one, `reference` (H, W, F): a capture of the empty corner. Each
    image becomes an EXR (radial depth, mask, phasor), a PNG and a PLY point cloud.
    """
    import model
    from model.capture.record import imported_fov_deg

    record = out.resolve() / "prediction.json"
    fov_deg = horizontal_fov_deg or imported_fov_deg(measurement)
    done = model.predict_file(run, measurement, out, horizontal_fov_deg=fov_deg, **options)
    for warning in done.check.warnings:
        say(f"warning: {warning}")
    where = f"depth maps, pictures and point clouds in {out}"
    tell([*done.sentences, where], record, as_json)


@night_eval.command(short_help="The network as an ONNX file.")
@click.argument("run", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="File to write; it ends in .onnx.")
@JSON
def export(run: Path, out: Path, as_json: bool) -> None:
    """Write the network of RUN as an ONNX file, checked against PyTorch.

    Input `channels` (N, C, H, W). The output is `components` (N, 2, H, W), or depth, or mask and depth, by
    other names (docs/guide/captures.md); the run's settings are in the metadata.
    """
    import model

    check = model.export_onnx(run, out)
    tell([check.sentence(out)], {"file": str(out), **asdict(check)}, as_json)


@night_eval.command("compact", short_help="The run at half its size, to publish.")
@click.argument("run", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Run folder to write.")
@JSON
def compact_run(run: Path, out: Path, as_json: bool) -> None:
    """Write RUN with weights of 16 bits and without its checkpoint, to be published or kept.

    Predictions, evaluations and `night-train --from` take it as any run; it cannot be resumed.
    """
    import model

    made = model.compact(run, out)
    size = sum(file.stat().st_size for file in made.iterdir())
    tell([f"{out}: {size / 1e6:.1f} MB"], {"run": str(out), "bytes": size}, as_json)
