"""What the tests of damage share: the fork server, the samples, how many inputs, and the table of results."""

import os
from pathlib import Path

import pytest
from forked import Forks
from fuzzing import SLOTS, Slot
from samples import write_samples

INPUTS = int(os.environ.get("NIGHT_FUZZ_INPUTS", "5"))  # of each format
KILLS = int(os.environ.get("NIGHT_FUZZ_KILLS", "6"))  # of each command
FIRST_SEED = int(os.environ.get("NIGHT_FUZZ_SEED", "1"))
TABLE = os.environ.get("NIGHT_FUZZ_TABLE")  # file for the table of results
_rows = []


@pytest.fixture(scope="session")
def forks():
    return Forks()


@pytest.fixture(scope="session")
def samples(render_here, tmp_path_factory):
    """Template of the arenas; for reading only."""
    folder = tmp_path_factory.mktemp("samples")
    write_samples(folder, render_here)
    return folder


@pytest.fixture(scope="session")
def slots(forks, samples, tmp_path_factory):
    return [Slot(forks, tmp_path_factory.mktemp("fuzz") / f"{number}", samples) for number in range(SLOTS)]


@pytest.fixture(scope="session")
def tell():
    """Add a row to the table: a theme, what it is about, and numbers by name."""
    return lambda theme, name, numbers: _rows.append((theme, name, numbers))


def pytest_report_header():
    return f"seed of damage and kills: {FIRST_SEED} (NIGHT_FUZZ_SEED)"


def pytest_terminal_summary(terminalreporter):
    """Print the table, and write it to TABLE if that is given."""
    text = "\n\n".join(_table(theme) for theme in dict.fromkeys(theme for theme, _, _ in _rows))
    if text:
        terminalreporter.section(f"damage and kills, seed {FIRST_SEED}")
        terminalreporter.write_line(text)
    if text and TABLE:
        Path(TABLE).write_text(f"Seed {FIRST_SEED}.\n\n{text}\n")


def _table(theme):
    """A Markdown table of a theme's rows, with their sums."""
    rows = [(name, numbers) for of, name, numbers in _rows if of == theme]
    columns = list(dict.fromkeys(column for _, numbers in rows for column in numbers))
    sums = {column: sum(numbers.get(column, 0) for _, numbers in rows) for column in columns}
    lines = [[theme, *columns], ["---", *("---:" for _ in columns)]]
    lines += [[name, *(str(numbers.get(c, 0)) for c in columns)] for name, numbers in [*rows, ("all", sums)]]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
