"""The pages of docs/tutorial run word for word, each in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT

PAGES = sorted((ROOT / "docs/tutorial").glob("*.md"))
TEXTS = {page.stem: page.read_text() for page in PAGES}
BLOCK = re.compile(r"^```(sh|python|toml|output)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
# Of a number that networks compute. No derivation: a training enlarges the rounding of another processor, and
# may end as with another seed. What the pages conclude holds for numbers within a third.
OTHER_PROCESSOR = 0.3


def run(language, block, folder):
    """Standard output of a block."""
    command = ["bash", "-ec", block] if language == "sh" else [sys.executable, "-c", block]
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{block}\n{done.stderr}"
    return done.stdout


def assert_output(shown, printed):
    """The lines that the page shows were printed; their words are equal, their numbers nearly so."""
    words = [NUMBER.sub("#", line) for line in printed.splitlines()]
    for line in shown.splitlines():
        assert NUMBER.sub("#", line) in words, f"{line}\n{printed}"
        same = printed.splitlines()[words.index(NUMBER.sub("#", line))]
        for number, other in zip(NUMBER.findall(line), NUMBER.findall(same), strict=True):
            last_digit = 10.0 ** -len(number.partition(".")[2])
            assert float(other) == pytest.approx(float(number), rel=OTHER_PROCESSOR, abs=last_digit), same


@pytest.mark.long
@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_the_page_does_what_it_says(text, tmp_path):
    printed = ""
    for language, block in BLOCK.findall(text):
        if language == "output":
            assert_output(block, printed)
        elif language == "toml":
            name = re.match(r"# (\w+\.toml)\n", block)[1]
            (tmp_path / name).write_text(block)
        else:
            printed = run(language, block, tmp_path)


def test_the_pages_import_public_names_only():
    for page in PAGES:
        imported = re.findall(
            r"^(?:from|import) (itof|model|render|scenegen)(\S*)", page.read_text(), re.MULTILINE
        )
        assert {rest for _, rest in imported} <= {""}
