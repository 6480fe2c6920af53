"""The command ``night-eval judge``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from commandline.endings import NightCommand
from commandline.options import DEVICE, FOLDER, MASK_FROM, MASK_THRESHOLD
from commandline.results import JSON, tell
from scenegen import open_dataset


@click.command(
    "judge", cls=NightCommand, short_help="Compare with the ground truth; the word may be left out."
)
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
    "--scene",
    "scenes",
    multiple=True,
    metavar="ID",
    help="Show this scene in the figures of several scenes; may be repeated.  [default: five, spread by "
    "accuracy]",
)
@MASK_FROM
@MASK_THRESHOLD
@DEVICE
@JSON
def judge(run: Path, dataset: Path, out: Path, as_json: bool, **options: Any) -> None:
    """Judge the network of RUN against the ground truth of DATASET; this word may be left out."""
    import model

    metrics = out.resolve() / "metrics.json"  # the folder "." is another one afterwards
    report = model.evaluate(run, open_dataset(dataset), out, **options)
    look = f"look at {out / 'index.html'}; figures and point clouds are beside it"
    tell([report.table, look], metrics, as_json)


@click.command("refine", cls=NightCommand, short_help="Find the solid that explains each measurement.")
@click.argument("run", type=FOLDER)
@click.argument("dataset", type=FOLDER)
@click.option("--out", required=True, type=FOLDER, help="Folder to write; a started one is continued.")
@click.option(
    "--split",
    type=click.Choice(["train", "validation", "test"]),
    default="test",
    show_default=True,
    help="Scenes to refine.",
)
@click.option(
    "--unknown",
    multiple=True,
    type=click.Choice(["sizes", "reflectance"]),
    help="Fit this, too, instead of taking the preset's; may be repeated.",
)
@click.option(
    "--largest-misfit",
    type=float,
    default=0.01,
    show_default=True,
    help="Share of the hidden light that an accepted fit may leave unexplained.",
)
@DEVICE
@JSON
def refine(run: Path, dataset: Path, out: Path, as_json: bool, **options: Any) -> None:
    """Refine the depth maps of RUN by rendering, and compare before and after with DATASET.

    For each scene, a box, sphere, cylinder, cone or bent sheet is moved until its three-bounce light is the
    measured one, from where the depth map of the network shows it. Where no solid explains the light, the
    depth map stays as it is.
    """
    import model

    report = model.refine_split(run, open_dataset(dataset), out, **options)
    look = f"depth maps and solids in {out / 'scenes'}"
    tell([report.table, report.sentence, look], out.resolve() / "refined.json", as_json)
