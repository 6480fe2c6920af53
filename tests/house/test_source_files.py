"""The files of the project: their sizes, and the documents that they refer to."""

import re
import statistics

from source_tree import ROOMS, ROOT

FOLDERS = (*ROOMS, "benchmarks", "docs", "tests")
MODULES = [ROOT / "cli.py", ROOT / "night_nlos.py"]
PROGRAMS = [*MODULES, *(file for folder in FOLDERS for file in sorted((ROOT / folder).rglob("*.py")))]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


def test_no_file_is_longer_than_350_lines_and_half_are_shorter_than_150():
    lines = {str(file.relative_to(ROOT)): len(file.read_text().splitlines()) for file in PROGRAMS}
    assert {file: count for file, count in lines.items() if count > 350} == {}
    assert statistics.median(lines.values()) < 150


def test_every_document_that_is_cited_is_in_the_repository():
    unpublished = re.compile(r"\b(?:DESIGN|STYLE) \d")  # notes of the authors; their facts are in docs/
    citing = [
        str(file.relative_to(ROOT)) for file in (*PROGRAMS, *PAGES) if unpublished.search(file.read_text())
    ]
    assert citing == []
