"""The history of a run, read back for its curves."""

from __future__ import annotations

import csv
from pathlib import Path

from model.run_folder import RunError


def read_history(run: Path) -> dict[str, list[float]]:
    """Columns of a run's ``history.csv``, whichever it has; nothing where there is no such file.

    Raises
    ------
    RunError : a damaged file.
    """
    file = run / "history.csv"
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            lines = list(csv.DictReader(stream))
        return {name: [float(line[name]) for line in lines] for name in (lines[0] if lines else ())}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise RunError(f"{file} cannot be read: {error}") from None
