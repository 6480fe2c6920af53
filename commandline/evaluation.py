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
