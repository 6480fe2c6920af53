"""The four commands: ``night-gen``, ``night-render``, ``night-train``, ``night-eval``.

Importing this file loads neither torch nor Mitsuba nor Blender: each command imports what it needs when it
runs. What the commands share is in `commandline`: how they end, and their options.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from commandline.endings import DefaultGroup, NightCommand, NightGroup, say
from commandline.options import DEVICE, FOLDER, ONLY, RENDER_SETTINGS, TRAINING, Megahertz, chosen_scenes
from scenegen import Dataset, Preset, leaks, open_dataset, preset_from_dict, read_settings
from scenegen.progress import showing_progress

if TYPE_CHECKING:
    from render import RenderSettings


@click.group(cls=NightGroup)
def night_gen() -> None:
    """Make look-behind-a-corner scenes in Blender."""


@night_gen.command(short_help="Make the scenes of a preset.")
@click.argument("out", type=FOLDER)
@click.option("--preset", default="paper", show_default=True, help="Name in data/presets, or a .toml file.")
@click.option("--count", type=int, help="Number of scenes instead of the preset's.")
@click.option("--seed", type=int, help="Seed instead of the preset's.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Processes that make scenes, 350 MB each; the dataset is the same.",
)
def scenes(out: Path, preset: str, count: int | None, seed: int | None, workers: int) -> None:
    """Make the scenes of a preset in the folder OUT; a larger --count than before adds scenes."""
    from scenegen.making.generation import check_target, generate
    from scenegen.making.generation_pool import generate_in_processes
    from scenegen.making.meshes import read_meshes

    settings, preset_folder = _overridden(preset, count, seed)
    meshes = read_meshes(settings, preset_folder)
    hashes = {shape: mesh.sha256 for shape, mesh in meshes.items()}
    check_target(out, settings, hashes)  # before Blender, which takes a second to load
    make_maker = functools.partial(_blender_maker, meshes)
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

    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only) if only else contact_sheet.choose_scenes(opened, count)
    preview_files.check_preview(opened, ids, licence)  # before Blender, which takes a second to load
    maker = _blender_maker(preview_files.meshes_in(opened))
    with showing_progress(len(opened.ids()) + len(ids), "scene", "preview") as bar:
        written = preview_files.write_preview(opened, ids, maker.picture, licence, bar.update)
    for file in written:
        click.echo(f"{file}")
    if dataset / "README.md" not in written:
        say(f"{dataset / 'README.md'} is not ours and was left alone: rename it to get a dataset card")


def _overridden(preset: str, count: int | None, seed: int | None) -> tuple[Preset, Path]:
    """The preset with what the command line gives instead of its own count and seed; its own folder."""
    data, origin = read_settings("presets", preset)
    changes = {key: value for key, value in (("count", count), ("seed", seed)) if value is not None}
    table = data.setdefault("dataset", {})
    if changes and isinstance(table, dict):
        table.update(changes)
    return preset_from_dict(data, origin), Path(origin).parent


def _blender_maker(meshes: Mapping[str, Any]) -> Any:
    """Start Blender in this process, one of the command's workers or itself."""
    from scenegen.making.blender import BlenderMaker

    return BlenderMaker(meshes)


@click.group(cls=DefaultGroup, default="render")
def night_render() -> None:
    """Render what the camera measures of every scene in DATASET, or work on what is rendered.

    What is rendered is kept; an interrupted run goes on when it is started again, on one machine or several.
    Settings that are not given are those the dataset was rendered with before. A dataset in a folder named
    like one of the commands is given as ./status.
    """


@night_render.command(short_help="Render DATASET; the word may be left out.")
@click.argument("dataset", type=FOLDER)
@RENDER_SETTINGS
@ONLY
@click.option("--workers", type=click.IntRange(min=1), help="Processes (one a device), or --cluster jobs.")
@click.option("--scheduler", metavar="ADDRESS", help="Render on a Dask cluster, like tcp://host:8786.")
@click.option("--cluster", type=FOLDER, metavar="FILE", help="Start one by this dask-jobqueue file.")
@click.option("--retry-failed", is_flag=True, help="Try scenes again that failed before.")
@click.option("--replace", is_flag=True, help="Render scenes again that were rendered with other settings.")
@click.option("--ignore-space", is_flag=True, help="Start although the disk looks too small.")
@click.option("--dry-run", is_flag=True, help="Print the plan, and render nothing.")
def render(dataset: Path, only: tuple[str, ...], dry_run: bool, **given: Any) -> None:
    """Render what the camera measures of every scene in DATASET; this word may be left out."""
    from render.farm.run import RunOptions, plan_run, render_dataset

    opened = open_dataset(dataset)
    names = ("workers", "scheduler", "retry_failed", "replace", "ignore_space")
    options = RunOptions(cluster_file=given.pop("cluster"), **{name: given.pop(name) for name in names})
    settings, ids = _render_settings(opened, given), chosen_scenes(opened, only)
    if dry_run:
        plan_run(opened, settings, ids, options, click.echo)
        return
    result = render_dataset(opened, settings, ids, options, say)
    click.echo("\n".join(result.sentences(opened.renders)))
    complaints = result.complaints(opened.renders)
    if complaints:
        say("\n".join(complaints))
        raise click.exceptions.Exit(1)


@night_render.command(short_help="How far DATASET is rendered.")
@click.argument("dataset", type=FOLDER)
@RENDER_SETTINGS
@ONLY
def status(dataset: Path, only: tuple[str, ...], **given: Any) -> None:
    """Say how far DATASET is rendered, what failed and how long the rest will take."""
    from render import read_status

    opened = open_dataset(dataset)
    found = read_status(opened, _render_settings(opened, given), chosen_scenes(opened, only))
    click.echo("\n".join(found.sentences()))


@night_render.command(short_help="Check every rendered file.")
@click.argument("dataset", type=FOLDER)
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Processes.")
@ONLY
def verify(dataset: Path, workers: int, only: tuple[str, ...]) -> None:
    """Check every rendered file of DATASET; bad scenes are rendered in the next run."""
    from render import verify as check

    opened = open_dataset(dataset)
    with showing_progress(None, "scene", "verify") as bar:
        report = check(opened, chosen_scenes(opened, only), workers=workers, on_scene=bar.update)
    click.echo("\n".join(report.sentences()))
    if report.problems:
        say("the next night-render renders the bad ones again")
        raise click.exceptions.Exit(1)


@night_render.command(short_help="A video of light in motion.")
@click.argument("dataset", type=FOLDER)
@click.argument("scene", metavar="ID")
@click.option("--out", type=FOLDER, metavar="FILE", help="An .mp4 or .gif file.  [default: ID.mp4]")
def movie(dataset: Path, scene: str, out: Path | None) -> None:
    """Make the light-in-motion video of the transient of the scene ID of DATASET."""
    from render import open_transient, write_movie

    opened = open_dataset(dataset)
    file = out or Path(f"{opened.entry(scene).id}.mp4")
    with open_transient(opened, scene) as transient:
        write_movie(transient, file)
    click.echo(f"the light of scene {scene} in motion: {file}")


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


@night_render.command(short_help="Delete transients, keep phasors.")
@click.argument("dataset", type=FOLDER)
@ONLY
def drop_transients(dataset: Path, only: tuple[str, ...]) -> None:
    """Delete the transients of DATASET and keep phasors and ground truth; only rendering brings them back."""
    from render.products.conversion import shrink_dataset

    opened = open_dataset(dataset)
    ids = chosen_scenes(opened, only)
    freed = shrink_dataset(opened, ids)
    click.echo(f"{len(ids)} scenes have no transients now: {freed / 1e6:.3g} MB freed")


def _render_settings(dataset: Dataset, given: Mapping[str, Any]) -> RenderSettings:
    """Settings of before, changed by the options that are given."""
    from render import settings_for

    return settings_for(dataset, {name: value for name, value in given.items() if value is not None})


@click.command(cls=NightCommand)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Run folder to write.")
@click.option(
    "--preset", help="Settings: a name in data/training, or a .toml file.  [default for a new run: default]"
)
@click.option("--resume", is_flag=True, help="Go on with the run in --out, by its own settings.")
@TRAINING
def night_train(dataset: Path, out: Path, preset: str | None, resume: bool, **options: Any) -> None:
    """Train a network on the renders of DATASET; options override the preset.

    Ctrl-C and SIGTERM leave a checkpoint that --resume goes on from. On several GPUs:

    \b
    torchrun --nproc-per-node 4 $(which night-train) DATASET --out RUN
    """  # noqa: D301
    import model
    from model.training.processes import is_first_process

    opened = open_dataset(dataset)
    before = model.run_settings(out) if resume else {}
    named = preset or (None if resume else "default")
    data, origin = model.training_preset(named) if named else ({}, "options")
    given = {name: value for name, value in options.items() if value is not None}
    model.settings_from_dict(given, "options")  # what is wrong with them is not the preset's fault
    settings = model.settings_from_dict(before | data | given, origin)
    result = model.train(opened, out, settings, resume=resume)
    if is_first_process():
        click.echo(result.sentence(out))


@click.group(cls=DefaultGroup, default="judge")
def night_eval() -> None:
    """Judge the network of RUN against the ground truth of DATASET, or use it.

    \b
    night-eval RUN DATASET --out REPORT       judge it (or: night-eval judge RUN DATASET ...)
    night-eval predict RUN INPUT --out DIR    depth maps of your own measurements
    night-eval export RUN --out MODEL.onnx    the network as an ONNX file
    """  # noqa: D301


@night_eval.command(short_help="Compare with the ground truth; the word may be left out.")
@click.argument("run", type=FOLDER)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Report folder to write.")
@click.option(
    "--split",
    type=click.Choice(["train", "validation", "test"]),
    default="test",
    show_default=True,
    help="Scenes to judge by.",
)
@click.option(
    "--mask-threshold",
    type=click.FloatRange(min=0, min_open=True),
    help="Amplitude from which on a pixel shows the object, instead of the run's.",
)
@DEVICE
def judge(run: Path, dataset: Path, out: Path, **options: Any) -> None:
    """Judge the network of RUN against the ground truth of DATASET; this word may be left out."""
    import model

    report = model.evaluate(run, open_dataset(dataset), out, **options)
    click.echo(report.table)
    click.echo(f"look at {out / 'index.html'}; figures and point clouds are beside it")


@night_eval.command(short_help="Depth maps of your own measurements.")
@click.argument("run", type=FOLDER)
@click.argument("measurement", metavar="INPUT", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Folder to write; an earlier prediction is replaced.")
@click.option(
    "--rescale/--no-rescale",
    default=None,
    help="Bring each image's mean amplitude to that of the training scenes, or trust the unit of INPUT. By "
    "default .npz and .h5 are rescaled, .exr is not.",
)
@DEVICE
def predict(run: Path, measurement: Path, out: Path, rescale: bool | None, device: Any) -> None:
    """Predict depth maps from the measurements in INPUT by the network of RUN.

    INPUT is an itof.exr, or an .npz or .h5 file with `phasors` (H, W, F) or (N, H, W, F) complex,
    `frequencies_hz` (F) and, if there is one, `reference` (H, W, F): a capture of the empty corner. Each
    image becomes an EXR (radial depth, mask, phasor), a PNG and a PLY point cloud.
    """
    import model

    images = model.predict_file(run, measurement, out, rescale=rescale, device=device)
    for image in images:
        click.echo(image.sentence)
    click.echo(f"depth maps, pictures and point clouds in {out}")


@night_eval.command(short_help="The network as an ONNX file.")
@click.argument("run", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="File to write; it ends in .onnx.")
def export(run: Path, out: Path) -> None:
    """Write the network of RUN as an ONNX file, checked against PyTorch.

    Input `channels` (N, C, H, W), output `components` (N, 2, H, W); the run's settings are in the metadata.
    """
    import model

    click.echo(model.export_onnx(run, out).sentence(out))
