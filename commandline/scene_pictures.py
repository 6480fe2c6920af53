"""Commands of ``night-render`` that make a picture or a film of a scene: ``movie``, ``plot``, ``panels``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from commandline.endings import NightCommand
from commandline.options import DEVICE, FOLDER, Pixel
from scenegen import open_dataset

if TYPE_CHECKING:
    from render.backend import Device


@click.command(cls=NightCommand, short_help="A video of light in motion.")
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


@click.command(cls=NightCommand, short_help="The transient vector of a pixel.")
@click.argument("dataset", type=FOLDER)
@click.argument("scene", metavar="ID")
@click.option(
    "--pixel",
    type=Pixel(),
    help="Column and row, from 0,0 at the upper left.  [default: the pixel with the most hidden light]",
)
@click.option("--out", type=FOLDER, metavar="FILE", help="A .png file.  [default: ID_transient.png]")
def plot(dataset: Path, scene: str, pixel: tuple[int, int] | None, out: Path | None) -> None:
    """Draw the light of a pixel of the scene ID of DATASET over time, direct and hidden light apart."""
    from render import write_transient_plot

    opened = open_dataset(dataset)
    file = out or Path(f"{opened.entry(scene).id}_transient.png")
    found = write_transient_plot(opened, scene, file, pixel)
    click.echo(f"{found.sentence(scene)}: {file}")


@click.command(cls=NightCommand, short_help="The mirror trick in three pictures.")
@click.argument("dataset", type=FOLDER)
@click.argument("scene", metavar="ID")
@click.option("--out", type=FOLDER, metavar="FILE", help="A .png file.  [default: ID_panels.png]")
@click.option(
    "--width", type=click.IntRange(16, 1920), default=320, show_default=True, help="Of each picture, pixels."
)
@DEVICE
def panels(dataset: Path, scene: str, out: Path | None, width: int, device: Device) -> None:
    """Draw the scene ID of DATASET as it is, with a mirror as its relay wall, and after the mirror trick.

    The three pictures show what the camera sees in ordinary light; the scene need not be rendered before.
    """
    from render import write_mirror_panels

    opened = open_dataset(dataset)
    entry = opened.entry(scene)
    file = out or Path(f"{entry.id}_panels.png")
    write_mirror_panels(opened, scene, file, width=width, device=device)
    click.echo(f"the mirror trick with scene {scene}: {file}")


PICTURE_COMMANDS = (movie, plot, panels)
