"""The command ``night-render export``."""

from __future__ import annotations

from pathlib import Path

import click

from commandline.endings import NightCommand
from commandline.options import FOLDER
from commandline.results import JSON, tell
from scenegen import open_dataset
from scenegen.progress import showing_progress


@click.command("export", cls=NightCommand, short_help="All of DATASET in one HDF5 or Zarr file.")
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
