"""The four commands: ``night-gen``, ``night-render``, ``night-train``, ``night-eval``.

Whatever is wrong with the input becomes one sentence on stderr and exit code 2. Set ``NIGHT_TRACEBACK=1``
to see where an error came from.
"""

from __future__ import annotations

import functools
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from tqdm import tqdm

import scenegen
from scenegen import Preset

if TYPE_CHECKING:
    from render.farm.run import RunResult

DEVICE = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    show_default=True,
    help="Where to compute; auto takes a GPU if there is one.",
)
FOLDER = click.Path(path_type=Path)


class Refusal(click.ClickException):
    """A one-sentence error with exit code 2."""

    exit_code = 2


def refusing(command: Callable[..., None]) -> Callable[..., None]:
    """Turn the errors that input can cause into one sentence; leave the rest of click as it is."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        logging.basicConfig(level=logging.INFO, format="%(message)s")
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that `finally` runs
        try:
            command(*args, **kwargs)
        except KeyboardInterrupt:
            click.echo("interrupted", err=True)
            sys.exit(128 + signal.SIGINT)
        except (ValueError, RuntimeError, ArithmeticError, MemoryError, OSError) as error:
            # click's own exceptions are RuntimeErrors that it knows how to show.
            if isinstance(error, click.exceptions.Exit | click.ClickException | click.Abort):
                raise
            if os.environ.get("NIGHT_TRACEBACK"):
                raise
            raise Refusal(_sentence(error)) from None

    return wrapped


@click.group()
@click.version_option(package_name="night-nlos")
def night_gen() -> None:
    """Make look-behind-a-corner scenes in Blender."""


@night_gen.command()
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
@refusing
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
    with tqdm(total=settings.dataset.count, unit="scene", desc="scenes", disable=None) as bar:
        if workers == 1:
            dataset = generate(out, settings, make_maker(), lambda: bar.update(), meshes=hashes)
        else:
            dataset = generate_in_processes(
                out, settings, make_maker, lambda: bar.update(), workers=workers, meshes=hashes
            )
    found = scenegen.leaks(dataset.scene(scene_id) for scene_id in dataset.ids())
    if found:
        click.echo(f"warning: the splits leak in {len(found)} places, for example: {found[0]}", err=True)
    parts = [f"{len(dataset.ids(split))} {split}" for split in ("train", "validation", "test")]
    click.echo(f"{len(dataset.ids())} scenes in {out}: {', '.join(parts)}")


@night_gen.command()
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
@refusing
def preview(dataset: Path, count: int, only: tuple[str, ...], licence: str | None) -> None:
    """Draw a contact sheet and plots of DATASET, and write its card, README.md."""
    from render.products import contact_sheet
    from render.products import preview as preview_files

    opened = scenegen.open_dataset(dataset)
    ids = [opened.entry(scene_id).id for scene_id in dict.fromkeys(only)]
    ids = ids or contact_sheet.choose_scenes(opened, count)
    preview_files.check_preview(opened, ids, licence)  # before Blender, which takes a second to load
    maker = _blender_maker(preview_files.meshes_in(opened))
    with tqdm(total=len(opened.ids()) + len(ids), unit="scene", desc="preview", disable=None) as bar:
        written = preview_files.write_preview(opened, ids, maker.picture, licence, lambda: bar.update())
    for file in written:
        click.echo(f"{file}")
    if dataset / "README.md" not in written:
        click.echo(
            f"{dataset / 'README.md'} is not ours and was left alone: rename it to get a dataset card",
            err=True,
        )


@click.command()
@click.argument("dataset", type=FOLDER)
@click.option("--method", help="many-light (the default), or path: slower, for any scene at all.")
@click.option(
    "--product",
    type=click.Choice(["itof", "transient", "both"]),
    help="itof: phasors and ground truth, a few MB a scene; transient, both (default): transients too.",
)
@click.option("--error", type=float, help="many-light: wanted error of the hidden signal (0.01).")
@click.option("--lights", type=click.IntRange(min=1), help="many-light: surface points, instead of --error.")
@click.option(
    "--spp",
    type=click.IntRange(min=1),
    help="path: paths per pixel (4096); the hidden signal's error is 10 to 15 / sqrt(spp).",
)
@click.option("--max-bounces", type=click.IntRange(min=1), help="Instead of the preset's.")
@DEVICE
@click.option("--resolution", metavar="WxH", help="Image size instead of the preset's, same aspect ratio.")
@click.option("--only", multiple=True, metavar="ID", help="Only this scene; may be repeated.")
@click.option(
    "--workers", type=click.IntRange(min=1), help="Worker processes (one a device), or --cluster jobs."
)
@click.option(
    "--scheduler", metavar="ADDRESS", help="Render on a running Dask cluster, like tcp://host:8786."
)
@click.option(
    "--cluster", type=FOLDER, metavar="FILE", help="Start one by this dask-jobqueue file (SLURM, PBS)."
)
@click.option("--retry-failed", is_flag=True, help="Try scenes again that failed before.")
@click.option("--replace", is_flag=True, help="Render scenes again that were rendered with other settings.")
@click.option("--ignore-space", is_flag=True, help="Start although the disk looks too small.")
@click.option("--status", is_flag=True, help="Say how far the dataset is rendered, and do nothing.")
@click.option(
    "--verify", is_flag=True, help="Check every rendered file; bad scenes are rendered in the next run."
)
@click.option("--movie", metavar="ID", help="Make the light-in-motion video of a scene's transient.")
@click.option(
    "--convert",
    type=click.Choice(["itof", "tal"]),
    help="itof: delete transients, keep phasors; with --out, phasors from transients. tal: HDF5 for y-tal.",
)
@click.option("--out", type=FOLDER, help="File of --movie, folder of --convert.")
@click.option("--frequencies", metavar="MHZ,...", help="Of --convert itof --out, instead of the dataset's.")
@click.version_option(package_name="night-nlos")
@refusing
def night_render(dataset: Path, only: tuple[str, ...], workers: int | None, **given: Any) -> None:
    """Render what the camera measures of every scene in DATASET.

    What is rendered is kept; an interrupted run goes on when it is started again, on one machine or several.
    Settings that are not given are those the dataset was rendered with before.
    """
    import render

    opened = scenegen.open_dataset(dataset)
    ids = [opened.entry(scene_id).id for scene_id in dict.fromkeys(only)] or opened.ids()
    tasks = ("status", "verify", "movie", "convert", "out", "frequencies")
    task = {name: given.pop(name) for name in tasks}
    names = ("scheduler", "retry_failed", "replace", "ignore_space")
    options = render.RunOptions(
        workers=workers, cluster_file=given.pop("cluster"), **{name: given.pop(name) for name in names}
    )
    given["resolution"] = _size(given["resolution"])
    asked = {name: value for name, value in given.items() if value is not None}
    settings = render.settings_for(opened, asked)
    if sum(bool(task[name]) for name in ("status", "verify", "movie", "convert")) > 1:
        raise click.UsageError("--status, --verify, --movie and --convert are tasks of their own: give one")
    if task["status"]:
        click.echo("\n".join(render.read_status(opened, settings, ids).sentences()))
    elif task["verify"]:
        _verify(opened, ids, workers or 1)
    elif task["movie"]:
        file = task["out"] or Path(f"{opened.entry(task['movie']).id}.mp4")
        with render.open_transient(opened, task["movie"]) as transient:
            render.write_movie(transient, file)
        click.echo(f"the light of scene {task['movie']} in motion: {file}")
    elif task["convert"]:
        _convert(opened, ids, task["convert"], task["out"], _hertz(task["frequencies"]))
    else:
        result = render.render_dataset(opened, settings, ids, options, _say)
        _summarise(dataset, result)


def _convert(
    dataset: scenegen.Dataset,
    ids: list[str],
    form: str,
    out: Path | None,
    frequencies_hz: tuple[float, ...] | None,
) -> None:
    """Other forms of the transients: captures for y-tal, phasors at any frequencies, or none at all."""
    import render
    from render.products.conversion import shrink_dataset

    if out is None and (form == "tal" or frequencies_hz):
        raise click.UsageError(f"--convert {form} needs a folder to write to: give --out FOLDER")
    if out is None:
        freed = shrink_dataset(dataset, ids)
        click.echo(f"{len(ids)} scenes have no transients now: {freed / 1e6:.3g} MB freed")
        return
    for scene_id in tqdm(ids, unit="scene", desc="convert", disable=None):
        if form == "tal":
            render.export_tal(dataset, scene_id, out / f"{scene_id}.hdf5")
        else:
            render.convert_to_itof(dataset, scene_id, out, frequencies_hz)
    click.echo(f"{len(ids)} scenes converted in {out}")


def _hertz(megahertz: str | None) -> tuple[float, ...] | None:
    """``20,62.5`` as Hz, ascending."""
    if megahertz is None:
        return None
    try:
        return tuple(sorted(float(f"{float(number)}e6") for number in megahertz.split(",")))
    except ValueError:
        raise click.BadParameter(
            f"{megahertz!r} is no list of frequencies; write it like 20,62.5", param_hint="--frequencies"
        ) from None


def _say(sentence: str) -> None:
    click.echo(sentence, err=True)


def _summarise(dataset: Path, result: RunResult) -> None:
    """Closing lines of a run; exit code 1 when scenes failed."""
    click.echo(f"{result.rendered} scenes rendered, {result.present} were there; {dataset / 'renders'}")
    for scene_id, reason in sorted(result.failures.items()):
        click.echo(f"failed: scene {scene_id}: {reason}", err=True)
    if result.failures:
        click.echo(
            f"{len(result.failures)} scenes failed; logs are in {dataset / 'renders'}/<id>/failure.log, and "
            "night-render --retry-failed tries them again",
            err=True,
        )
    if result.skipped_failures:
        click.echo(
            f"{result.skipped_failures} scenes failed earlier and were left out: night-render --retry-failed "
            "tries them again, --status names them",
            err=True,
        )
    if result.failures or result.skipped_failures:
        raise click.exceptions.Exit(1)


def _verify(dataset: scenegen.Dataset, ids: list[str], workers: int) -> None:
    """Check renders; exit code 1 when some are bad."""
    import render

    with tqdm(unit="scene", desc="verify", disable=None) as bar:
        report = render.verify(dataset, ids, workers=workers, on_scene=bar.update)
    for scene_id, problems in report.problems.items():
        click.echo(f"bad: {scene_id}: {'; '.join(problems)}")
    click.echo(
        f"{report.checked} scenes checked: {report.checked - len(report.problems)} good, "
        f"{len(report.problems)} bad; {len(ids) - report.checked} not rendered"
    )
    if report.problems:
        click.echo("the next night-render renders the bad ones again", err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Run folder to write.")
@click.option(
    "--preset", help="Settings: a name in data/training, or a .toml file.  [default for a new run: default]"
)
@click.option("--channels", help="Network input: paper, residual or paper+residual.")
@click.option("--frequencies", metavar="MHZ,...", help="That the network sees, like 20,60; else all.")
@click.option("--width", type=click.IntRange(min=1), help="Channels of the U-Net's first level.")
@click.option("--loss", help="mae, mse, mae+iou or mse+iou.")
@click.option("--loss-on", help="What the error is taken on: components or depth.")
@click.option("--alpha", type=click.FloatRange(min=0), help="Weight of the object in the loss.")
@click.option("--learning-rate", type=click.FloatRange(min=0, min_open=True), help="Adam's step.")
@click.option("--schedule", help="Of the learning rate: constant or cosine.")
@click.option("--warm-up-epochs", type=click.FloatRange(min=0), help="In which the learning rate grows.")
@click.option("--clip-norm", type=click.FloatRange(min=0), help="Largest norm of the gradient; 0: any.")
@click.option("--ema-decay", type=click.FloatRange(0, 1, max_open=True), help="Of averaged weights; 0: none.")
@click.option("--batch-size", type=click.IntRange(min=1), help="Scenes a step.")
@click.option("--max-epochs", type=click.IntRange(min=1), help="Longest training.")
@click.option("--patience", type=click.IntRange(min=1), help="Epochs without a better validation loss.")
@click.option("--flip-rows/--no-flip-rows", default=None, help="Flip top and bottom: an exact symmetry.")
@click.option("--flip-columns/--no-flip-columns", default=None, help="Flip left and right: the paper does.")
@click.option("--rotation-deg", type=click.FloatRange(0, 180), help="Turn by up to this; the paper: 180.")
@click.option("--translation", type=click.FloatRange(0, 1), help="Shift by up to this part; the paper: 0.2.")
@click.option("--amplitude-spread", type=click.FloatRange(min=0), help="Other exposures, to 1 + this times.")
@click.option("--noise-sigma", type=click.FloatRange(min=0), help="Sensor noise, in 20 MHz amplitudes.")
@click.option("--precision", help="Of the convolutions: auto, float32, bfloat16 or float16.")
@click.option("--channels-last/--no-channels-last", default=None, help="Memory order of images.")
@click.option("--compile/--no-compile", default=None, help="Compile the network (a minute at the start).")
@click.option("--checkpoint-minutes", type=click.FloatRange(min=0), help="Between two checkpoints.")
@click.option("--seed", type=click.IntRange(min=0), help="Of weights, order and augmentation.")
@DEVICE
@click.option("--resume", is_flag=True, help="Go on with the run in --out, by its own settings.")
@click.version_option(package_name="night-nlos")
@refusing
def night_train(
    dataset: Path, out: Path, preset: str | None, frequencies: str | None, resume: bool, **options: Any
) -> None:
    """Train a network on the renders of DATASET; options override the preset.

    Ctrl-C and SIGTERM leave a checkpoint that --resume goes on from. On several GPUs:

    \b
    torchrun --nproc-per-node 4 $(which night-train) DATASET --out RUN
    """  # noqa: D301
    import model
    from model.training.processes import is_first_process

    opened = scenegen.open_dataset(dataset)
    before = model.run_settings(out) if resume else {}
    named = preset or (None if resume else "default")
    data, origin = model.training_preset(named) if named else ({}, "options")
    given = {name: value for name, value in options.items() if value is not None}
    if frequencies is not None:
        given["frequencies_hz"] = _hertz(frequencies)
    model.settings_from_dict(given, "options")  # what is wrong with them is not the preset's fault
    settings = model.settings_from_dict(before | data | given, origin)
    result = model.train(opened, out, settings, resume=resume)
    if is_first_process():
        click.echo(
            f"{result.epochs} epochs, ended by {result.ended_by}; best validation loss "
            f"{result.best_validation_loss:.4f} in epoch {result.best_epoch}; run in {out}"
        )


class DefaultGroup(click.Group):
    """A group of commands, one of which (`default`) is meant where the first word names none of them."""

    default = "judge"

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command's name before what cannot be meant for the group."""
        if args and args[0] not in self.commands and args[0] not in ("--help", "--version"):
            args = [self.default, *args]
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """The usage line of the default command; the others are listed below it."""
        return self.commands[self.default].collect_usage_pieces(ctx)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The default command's options, then the list of commands."""
        parameters = self.commands[self.default].get_params(ctx)
        options = [parameter for parameter in parameters if isinstance(parameter, click.Option)]
        records = [record for option in options if (record := option.get_help_record(ctx)) is not None]
        with formatter.section("Options"):
            formatter.write_dl(records)
        self.format_commands(ctx, formatter)


@click.group(cls=DefaultGroup)
@click.version_option(package_name="night-nlos")
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
    "--split", type=click.Choice(["train", "validation", "test"]), default="test", show_default=True
)
@click.option(
    "--mask-threshold",
    type=click.FloatRange(min=0, min_open=True),
    help="Amplitude from which on a pixel shows the object, instead of the run's.",
)
@DEVICE
@click.version_option(package_name="night-nlos")
@refusing
def judge(run: Path, dataset: Path, out: Path, **options: Any) -> None:
    """Judge the network of RUN against the ground truth of DATASET; this word may be left out."""
    import model

    report = model.evaluate(run, scenegen.open_dataset(dataset), out, **options)
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
@refusing
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
@refusing
def export(run: Path, out: Path) -> None:
    """Write the network of RUN as an ONNX file, checked against PyTorch.

    Input `channels` (N, C, H, W), output `components` (N, 2, H, W); the run's settings are in the metadata.
    """
    import model

    check = model.export_onnx(run, out)
    click.echo(
        f"{out}: differs from PyTorch by at most {check.largest_difference:.2g} where outputs reach "
        f"{check.largest_output:.2g} ({check.tolerance:.2g} is rounding)"
    )


def _overridden(preset: str, count: int | None, seed: int | None) -> tuple[Preset, Path]:
    """The preset with what the command line gives instead of its own count and seed; its own folder."""
    data, origin = scenegen.read_settings("presets", preset)
    changes = {key: value for key, value in (("count", count), ("seed", seed)) if value is not None}
    table = data.setdefault("dataset", {})
    if changes and isinstance(table, dict):
        table.update(changes)
    return scenegen.preset_from_dict(data, origin), Path(origin).parent


def _blender_maker(meshes: Mapping[str, Any]) -> Any:
    """Start Blender in this process, one of the command's workers or itself."""
    from scenegen.making.blender import BlenderMaker

    return BlenderMaker(meshes)


def _size(resolution: str | None) -> tuple[int, int] | None:
    if resolution is None:
        return None
    match = re.fullmatch(r"(\d+)x(\d+)", resolution)
    if match is None:
        raise click.BadParameter(
            f"{resolution!r} is no image size; write it like 160x120", param_hint="--resolution"
        )
    return int(match[1]), int(match[2])


def _sentence(error: BaseException) -> str:
    if isinstance(error, OSError) and error.strerror:
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror}"
    if isinstance(error, MemoryError):
        return f"out of memory {error}".strip() + ": use a smaller resolution, batch or bin_count"
    return " ".join(str(error).split()) or type(error).__name__
