"""The commands of ``night-eval``, but for those on captures (`commandline.captures`)."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from commandline.captures import capture
from commandline.endings import DefaultGroup
from commandline.options import (
    COUNT,
    DEVICE,
    FOLDER,
    FORCE,
    FOV,
    MASK_FROM,
    MASK_THRESHOLD,
    RESCALE,
    Counts,
    Sensor,
    option,
)
from commandline.results import JSON, tell
from commandline.streams import say
from model.refinement.settings import LARGEST_MISFIT, UNKNOWNS
from scenegen import load_preset, open_dataset

if TYPE_CHECKING:
    from model.prediction.predicted_image import FilePrediction

_OF_THE_REPORT = ("scenes", "mask_from", "mask_threshold")
_OF_THE_CAMERA = ("exposures", "corner_exposures", "each_imperfection", "first")
_OF_A_DATASET, _OF_A_FILE, _WITH_SENSOR = "Of a dataset", "Of a file", "With --sensor"  # headings
_Command = TypeVar("_Command", bound=Callable[..., Any])


def _split(words: str) -> Callable[[_Command], _Command]:
    """The option that names the scenes to work on."""
    splits = click.Choice(["train", "validation", "test"])
    return click.option("--split", type=splits, default="test", show_default=True, help=words)


@click.group(cls=DefaultGroup, default="judge")
def night_eval() -> None:
    """Judge the network of RUN against the ground truth of DATASET, or use it.

    \b
    night-eval networks                       those that come with NIGHT, and what each needs
    night-eval RUN DATASET --out REPORT       judge it (or: night-eval judge RUN DATASET ...)
    night-eval refine RUN INPUT --out DIR     find the solids that explain each measurement
    night-eval predict RUN INPUT --out DIR    depth maps of your own measurements
    night-eval export RUN --out MODEL.onnx    the network as an ONNX file
    night-eval capture import INPUT ...       measurements of the raw frames of a camera
    night-eval compact RUN --out DIR          the run at half its size, to publish
    """  # noqa: D301


night_eval.add_command(capture)


@night_eval.command("judge", short_help="Compare with the ground truth; the word may be left out.")
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
@option(
    _WITH_SENSOR,
    "--sensor",
    type=Sensor(),
    help="Let this camera measure the scenes: a name in data/sensors, or a .toml file. OUT then holds the "
    "error at each exposure instead of the report.",
)
@option(_WITH_SENSOR, "--exposures", type=Counts(), help="Exposures that are averaged.  [default: 1]")
@option(
    _WITH_SENSOR,
    "--corner-exposures",
    type=click.IntRange(0, 1_000_000),
    help="Averaged exposures of the empty corner, as reference.  [default: no capture]",
)
@option(
    _WITH_SENSOR,
    "--each-imperfection",
    is_flag=True,
    default=None,
    help="Each imperfection of the camera alone, and all but it; at one number of exposures.",
)
@option(_WITH_SENSOR, "--first", type=COUNT, help="Judge the first so many scenes only.")
@FORCE
@DEVICE
@JSON
def judge(
    run: Path, dataset: Path, out: Path, as_json: bool, sensor: Any, force: bool, **options: Any
) -> None:
    """Judge the network of RUN against the ground truth of DATASET; this word may be left out."""
    import model

    given = {name: value for name, value in options.items() if value not in (None, ())}
    _refuse_mixed(given, behind_camera=sensor is not None)
    if sensor is not None:
        numbers = out.resolve() / "exposures.json"  # the folder "." is another one afterwards
        found = model.judge_exposures(run, open_dataset(dataset), out, sensor, force=force, **given)
        tell([found.table, f"all numbers in {out}"], numbers, as_json)
        return
    metrics = out.resolve() / "metrics.json"
    report = model.evaluate(run, open_dataset(dataset), out, force=force, **given)
    for warning in report.warnings:
        say(f"warning: {warning}")
    beside = "figures, point clouds and the film" if report.frame_rate_hz else "figures and point clouds"
    look = f"look at {out / 'index.html'}; {beside} are beside it"
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


@night_eval.command("refine", short_help="Find the solids that explain each measurement.")
@click.argument("run", type=FOLDER)
@click.argument("measured", metavar="INPUT", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Folder to write; one of a dataset is continued.")
@click.option(
    "--objects",
    metavar="PRESET",
    help="Which solids may be there, of which sizes and reflectance: those of this preset, a name in "
    "data/presets or a .toml file.  [default: those of the dataset, or all]",
)
@click.option(
    "--unknown",
    multiple=True,
    type=click.Choice(UNKNOWNS),
    help="Fit this, too, instead of taking the preset's; may be repeated.  [default: both for a file without "
    "--objects]",
)
@click.option(
    "--largest-misfit",
    type=float,
    default=LARGEST_MISFIT,
    show_default=True,
    help="Share of the hidden light that an accepted fit may leave unexplained.",
)
@option(
    _OF_A_DATASET,
    "--split",
    type=click.Choice(["train", "validation", "test"]),
    help="Scenes to refine (test).",
)
@option(_OF_A_DATASET, "--workers", type=COUNT, help="Processes that share the scenes (1).")
@option(
    _OF_A_FILE,
    "--room",
    metavar="PRESET",
    help="The corner: places of walls and camera in a preset. Without it, no middle wall hides anything.",
)
@FOV
@RESCALE
@FORCE
@DEVICE
@JSON
def refine(
    run: Path,
    measured: Path,
    out: Path,
    as_json: bool,
    objects: str | None,
    room: str | None,
    unknown: tuple[Any, ...],
    **options: Any,
) -> None:
    """Find the solids behind each measurement in INPUT, a dataset or a file as of `predict`.

    A box, sphere, cylinder, cone or bent sheet is moved until its three-bounce light is the measured one,
    from where the depth map of RUN shows the object. Where none is accepted, the depth map stays as it is.
    Those of a dataset are compared with its ground truth.
    """
    import model

    given = {name: value for name, value in options.items() if value is not None}
    preset = None if objects is None else load_preset(objects)
    is_file = not measured.is_dir()
    wrong = given.keys() & ({"split", "workers"} if is_file else {"horizontal_fov_deg", "rescale"})
    wrong |= {"room"} if room is not None and not is_file else set()
    if wrong:
        names = ", ".join(f"--{'fov' if name == 'horizontal_fov_deg' else name}" for name in sorted(wrong))
        which = "a dataset" if is_file else "a file with a measurement"
        raise click.UsageError(f"{names}: for {which}, which {measured} is not; leave it out")
    if is_file:
        corner = None if room is None else load_preset(room)
        done = model.refine(run, measured, out, room=corner, objects=preset, unknown=unknown or None, **given)
        _tell_prediction(done, out, as_json)
        return
    report = model.refine_split(run, open_dataset(measured), out, objects=preset, unknown=unknown, **given)
    look = f"depth maps and solids in {out / 'scenes'}"
    tell([report.table, report.sentence, look], out.resolve() / "refined.json", as_json)


@night_eval.command(short_help="Depth maps of your own measurements.")
@click.argument("run", type=FOLDER)
@click.argument("measurement", metavar="INPUT", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Folder to write; an earlier prediction is replaced.")
@click.option("--pictures/--no-pictures", default=True, show_default=True, help="Draw each image.")
@click.option(
    "--film", type=FOLDER, metavar="FILE", help="Write the pictures as a film, too: a .gif or .webp file."
)
@FOV
@RESCALE
@FORCE
@DEVICE
@JSON
def predict(
    run: Path,
    measurement: Path,
    out: Path,
    as_json: bool,
    **options: Any,
) -> None:
    """Predict depth maps from the measurements in INPUT by the network of RUN.

    INPUT is an itof.exr, or an .npz or .h5 file with `phasors` (H, W, F) or (N, H, W, F) complex,
    `frequencies_hz` (F) and, if there are any, `reference` (H, W, F): a capture of the empty corner, and
    `horizontal_fov_deg`, one or N. Each image becomes an EXR (radial depth, mask, phasor), a PLY point cloud
    and a picture.
    """
    import model

    done = model.predict_file(run, measurement, out, **options)
    _tell_prediction(done, out, as_json)


def _tell_prediction(done: FilePrediction, out: Path, as_json: bool) -> None:
    for warning in done.check.warnings:
        say(f"warning: {warning}")
    drawn = "depth maps, pictures and" if done.has_pictures else "depth maps and"
    where = f"{drawn} point clouds in {out}"
    tell([*done.sentences, where], out.resolve() / "prediction.json", as_json)


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


@night_eval.command("networks", short_help="What each network needs, and how good it is.")
@click.argument("runs", metavar="[RUN]...", nargs=-1, type=FOLDER)
@JSON
def list_networks(runs: tuple[Path, ...], as_json: bool) -> None:
    """List the networks that come with NIGHT, or those of each RUN, and what each needs of a measurement.

    Its image size and frequencies, its fields of view, how far the relay wall may be from where its training
    had it, the noise of its training, and its error on validation scenes.
    """
    from model.run_folder.networks import networks, table

    found = networks(runs)
    tell([table(found)], {"networks": [asdict(network) for network in found]}, as_json)


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
