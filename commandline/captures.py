"""The commands of ``night-eval capture``: import, check, corner, waves and pairs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import click

from commandline.endings import NightGroup, Refusal
from commandline.options import FOLDER, Number, Size, options
from commandline.results import JSON, tell
from disk import PresetError
from scenegen import load_preset

_SIDECAR = (
    "TOML file that says what the frames mean, or a known format: adi-adtf3175, arducam, depthai, espros, "
    "flat, night-authors, ti-tintin."
)
EMPTY = click.option(
    "--empty", multiple=True, type=FOLDER, help="Capture of the empty corner; may be repeated."
)
FRAMES = options(
    click.option(
        "--set", "changes", multiple=True, metavar="'KEY = VALUE'", help="Change a key of the sidecar."
    ),
    click.option(
        "--bin", "bin_side", type=click.IntRange(min=1), help="Sensor pixels a side of an image pixel."
    ),
    click.option(
        "--size", type=Size(), help="Image size instead; the largest window of this shape is taken."
    ),
    click.option(
        "--fov",
        "horizontal_fov_deg",
        type=Number(1, 170),
        help="Horizontal field of view of the image, degrees; less than the sensor's needs --size.",
    ),
)


@click.group("capture", cls=NightGroup, short_help="Raw frames of a real camera.")
def capture() -> None:
    """Bring raw frames of a real camera into NIGHT, and find out what is wrong with them."""


@capture.command("import", short_help="Make a measurement file of raw frames.")
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=FOLDER)
@click.option("--sidecar", required=True, type=FOLDER, help=_SIDECAR)
@click.option("--out", required=True, type=FOLDER, help="File to write: .npz, .h5 or .hdf5.")
@EMPTY
@FRAMES
@JSON
def import_(inputs: tuple[Path, ...], sidecar: Path, out: Path, as_json: bool, **given: Any) -> None:
    """Make a measurement file, which `night-eval predict` reads, of the raw frames in INPUT.

    INPUT are .npz, .npy, .h5, .exr or .mat files, grey pictures or bare numbers. Frames are averaged, and
    pixels binned, as phasors.
    """
    import itof

    done = itof.import_capture(inputs, sidecar, out, **given)
    reference = None if done.reference is None else asdict(done.reference.facts)
    result = {"file": str(out), "facts": asdict(done.capture.facts), "reference_facts": reference}
    tell(done.sentences, result, as_json)


@capture.command("check", short_help="What is wrong with a capture, in words.")
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=FOLDER)
@click.option("--sidecar", type=FOLDER, help=f"For raw frames: {_SIDECAR}")
@click.option("--out", type=FOLDER, help="Picture to write, .png; only an earlier one is replaced.")
@EMPTY
@FRAMES
@JSON
def check(
    inputs: tuple[Path, ...], sidecar: Path | None, out: Path | None, as_json: bool, **given: Any
) -> None:
    """Check a measurement file, or raw frames with a sidecar, by the wall that they show.

    Ends with exit code 2 if a prediction would be useless. Needs no network, and names those that come with
    NIGHT and can read it.
    """
    import itof
    from model.run_folder.networks import View, Wanted, readers

    if out is not None and out.suffix.lower() != ".png":
        raise click.BadParameter(f"{out} must end in .png", param_hint="--out")
    done = itof.check_capture(inputs, sidecar, picture=out, **given)
    if done.refused:
        if as_json:
            tell((), done.as_data(), as_json)
        raise Refusal(
            f"{inputs[0]} is no capture of a wall to predict from: {'; '.join(done.found.warnings)}"
        )
    planes = {
        None if wall is None or away_m is None else wall.plane_per_m
        for wall, away_m in zip(done.found.walls, done.distances_m, strict=True)
    }
    views = tuple(View(done.horizontal_fov_deg, plane_per_m) for plane_per_m in planes)
    wanted = Wanted(*done.image_size, done.frequencies_hz, views)
    names, sentence = readers(wanted, can_be_smaller=sidecar is not None)
    tell([*done.sentences, sentence], done.as_data() | {"networks": names}, as_json)


@capture.command("corner", short_help="The preset of a corner from its empty wall.")
@click.argument("inputs", metavar="EMPTY...", nargs=-1, required=True, type=FOLDER)
@click.option("--sidecar", type=FOLDER, help=f"For raw frames: {_SIDECAR}")
@click.option("--out", required=True, type=FOLDER, metavar="FILE", help="Preset to write, .toml.")
@FRAMES
@click.option(
    "--hidden",
    type=click.Choice(["left", "right"]),
    help="Side of the hidden region, as seen facing the wall.  [default: where the camera is turned to]",
)
@click.option(
    "--gap",
    "gap_m",
    type=Number(0.01, 100),
    metavar="METRES",
    help="From the relay wall to the middle wall.  [default: the paper's, 0.7]",
)
@click.option(
    "--aside",
    "aside_m",
    type=Number(0.01, 100),
    metavar="METRES",
    help="From the camera to the plane of the middle wall.  [default: the image ends beside that wall]",
)
@click.option(
    "--roll",
    "roll_deg",
    type=Number(-180, 180),
    default=0.0,
    show_default=True,
    metavar="DEGREES",
    help="Turn of the camera about its axis, clockwise as seen from behind.",
)
@click.option("--force", is_flag=True, help="Write the preset even if the wall's place is not certain.")
@click.option("--replace", is_flag=True, help="Replace a FILE that is there.")
@JSON
def corner(
    inputs: tuple[Path, ...],
    sidecar: Path | None,
    out: Path,
    force: bool,
    replace: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Write the preset of the corner whose empty relay wall EMPTY shows, for `night-gen` and `night-train`.

    EMPTY is a measurement file, or raw frames with a sidecar. What the wall does not show is that of the
    paper's corner; the file says what it is.
    """
    import render
    from disk.own_files import refuse_taken
    from scenegen.corner_check import refuse_impossible_corner

    _refuse_other_ending(out)
    refuse_taken(out, replacing=replace)
    found = render.captured_corner(inputs, sidecar, **given)
    if found.doubts and not force:
        raise Refusal(
            f"the place of the wall in {inputs[0]} is not certain, and --force writes it nevertheless: "
            f"{'; '.join(found.doubts)}"
        )
    render.write_captured_corner(found, out, replacing=replace)
    doubts = [f"warning: {doubt}" for doubt in found.doubts]
    tell([*doubts, *found.sentences, f"preset: {out}"], {"file": str(out), **found.as_data()}, as_json)
    try:
        refuse_impossible_corner(found.preset)
    except PresetError as error:
        raise Refusal(f"{out} needs measures of your corner: as assumed, it cannot be: {error}") from None


@capture.command("waves", short_help="A camera file with the waves that walls show.")
@click.argument("inputs", metavar="WALL...", nargs=-1, required=True, type=FOLDER)
@click.option(
    "--sensor",
    default="mlx75027",
    show_default=True,
    metavar="CAMERA",
    help="Camera with the other settings: a name in data/sensors, or a .toml file beside FILE.",
)
@click.option("--out", required=True, type=FOLDER, metavar="FILE", help="Camera file to write, .toml.")
@click.option(
    "--fov", "horizontal_fov_deg", type=Number(1, 170), help="Horizontal field of view, if no file says it."
)
@click.option("--replace", is_flag=True, help="Replace a FILE that is there.")
@JSON
def waves(
    inputs: tuple[Path, ...],
    sensor: str,
    out: Path,
    horizontal_fov_deg: float | None,
    replace: bool,
    as_json: bool,
) -> None:
    """Find the harmonics of a camera's waves, which make its phases err periodically.

    WALL are imported captures of a flat wall that fills the image, at several distances, which need not be
    known. Four are enough if they reach over a period of the error: 1.9 m at 20 MHz with four phase steps.
    """
    from disk.own_files import refuse_taken
    from itof.capture.waves import captured_waves, write_captured_waves

    _refuse_other_ending(out)
    refuse_taken(out, replacing=replace)
    found = captured_waves(inputs, sensor, horizontal_fov_deg=horizontal_fov_deg)
    write_captured_waves(found, out, replacing=replace)
    tell([*found.sentences, f"camera file: {out}"], {"file": str(out), **found.as_data()}, as_json)


def _refuse_other_ending(out: Path) -> None:
    if out.suffix.lower() != ".toml":
        raise click.BadParameter(f"{out} must end in .toml", param_hint="--out")


@capture.command("pairs", short_help="A dataset of captures and of a mirror's.")
@click.argument("folders", metavar="PAIR...", nargs=-1, required=True, type=FOLDER)
@click.option("--preset", required=True, help="The corner: a name in data/presets, or a .toml file.")
@click.option("--out", required=True, type=FOLDER, help="Dataset folder to write.")
@click.option(
    "--wall",
    type=click.Choice(["empty", "preset"]),
    default="empty",
    show_default=True,
    help="The relay wall is where captures of the empty corner show it, or where the preset has it.",
)
@JSON
def pairs(
    folders: tuple[Path, ...], preset: str, out: Path, wall: Literal["empty", "preset"], as_json: bool
) -> None:
    """Make a dataset of real pairs, for `night-train --from RUN` and `night-eval`.

    PAIR is a folder with two imported captures: measurement.npz of the corner, and mirror.npz by the same
    camera with a mirror on the relay wall, which shows the truth.
    """
    import render

    made = render.write_pairs(folders, load_preset(preset), out, wall=wall)
    found = None if made.wall is None else made.wall.as_data()
    told = {"dataset": str(out), "scenes": len(made.dataset.ids()), "reference_wall": found}
    tell(made.sentences, told, as_json)
