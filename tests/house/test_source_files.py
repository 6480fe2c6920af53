"""The files of the project: their sizes, and the documents that they refer to."""

import json
import re
import statistics
import subprocess
import sys
from fnmatch import fnmatch

import pytest
from source_tree import ROOMS, ROOT

FOLDERS = (*ROOMS, "benchmarks", "docs", "tests")
MODULES = [ROOT / "cli.py", ROOT / "night_nlos.py"]
PROGRAMS = [*MODULES, *(file for folder in FOLDERS for file in sorted((ROOT / folder).rglob("*.py")))]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]

COLLECTED = """
import contextlib, io, json, pytest
class Marked:
    def pytest_collection_modifyitems(self, items):
        markers = ("thorough", "long")
        found = [[item.nodeid, name] for item in items for name in markers if item.get_closest_marker(name)]
        self.marker_of = dict(reversed(found))
marked = Marked()
with contextlib.redirect_stdout(io.StringIO()):
    assert pytest.main(["--collect-only", "-q", "tests"], plugins=[marked]) == 0
print(json.dumps(marked.marker_of))
"""


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


@pytest.mark.long
def test_the_table_of_long_tests_counts_every_one_of_them():
    command = [sys.executable, "-c", COLLECTED]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    marker_of = json.loads(done.stdout)
    table = re.findall(
        r"^\| .* \| `(tests/.*)` \| (\d+) \| (\d+) \|$", (ROOT / "CONTRIBUTING.md").read_text(), re.M
    )
    counted = {kind: [0, 0] for kind, *_ in table}
    for test, marker in marker_of.items():
        kind = next(kind for kind in counted if fnmatch(test.split("::")[0], kind))
        counted[kind][marker == "thorough"] += 1
    assert {kind: [int(count) for count in counts] for kind, *counts in table} == counted
