"""Trained networks that come with the program: run folders in data/weights, found by their names."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from disk import PathLike, data_folder

WEIGHTS: Final = "weights"  # folder of data/


def shipped_runs() -> dict[str, Path]:
    """Run folders of the trained networks that come with the program, by name."""
    folder = data_folder(WEIGHTS)
    return {each.name: each for each in sorted(folder.iterdir())} if folder.is_dir() else {}


def run_folder(run: PathLike) -> Path:
    """The run folder `run`; if there is none, and it is the name of a shipped network, the folder of that."""
    folder = Path(run)
    if folder.exists():
        return folder
    return shipped_runs().get(os.fspath(run), folder)
