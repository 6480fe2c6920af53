"""The pages for readers: links, paths, names and commands in them exist."""

import importlib
import re
import shlex
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

import cli

ROOT = Path(__file__).parents[2]
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
MOST_WORDS, LONGEST_CELL = 25_000, 200
ROOMS = ("scenegen", "itof", "render", "model")
ROOM_FOLDERS = ("disk", "processes", *ROOMS, "commandline")
PROGRAMS = [
    *ROOT.glob("*.py"),
    *(
        file
        for folder in (*ROOM_FOLDERS, "benchmarks", "tests")
        for file in sorted((ROOT / folder).rglob("*.py"))
    ),
]
NO_PYTHON_NAMES = {
    "itof.exr",
    "itof.frequencies_hz",
    "model.onnx",
    "render.json",
}  # files, and a key of presets
COMMANDS = {
    "night-gen": cli.night_gen,
    "night-render": cli.night_render,
    "night-train": cli.night_train,
    "night-eval": cli.night_eval,
}


def name(page):
    return str(page.relative_to(ROOT))


def headings(page):
    """Titles of the sections of a page, without those in code blocks."""
    return re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S), re.M)


def anchor(heading):
    """The anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def code_lines(text):
    """Lines of code blocks, continued ones joined, and the code within sentences."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S)
    yield from (line for block in blocks for line in block.replace("\\\n", " ").splitlines())
    sentences = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    yield from (" ".join(code.split()) for code in re.findall(r"`([^`]+)`", sentences))


def table_cells(text):
    """Cells of tables as they are read: without the addresses of links."""
    for row in re.findall(r"^\|(.*)\|$", text, re.M):
        yield from re.split(r"(?<!\\)\|", re.sub(r"\]\([^)]*\)", "]", row))


def commands(text):
    """Calls of the four commands, as lists of words."""
    for line in code_lines(text):
        words = shlex.split(line, comments=True) if line.startswith("night-") else []
        if words and words[0] in COMMANDS and len(words) > 1:
            yield words


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=name)
def test_links_between_pages_lead_somewhere(page):
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        file, _, section = target.partition("#")
        linked = page.parent / file if file else page
        if target.startswith("https://"):
            continue
        if not linked.exists() or (section and section not in map(anchor, headings(linked))):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_files_that_a_page_names_exist(page):
    folders = "|".join((*ROOM_FOLDERS, "tests", "benchmarks", "data", "docs", "notebook", r"\.ci"))
    ours = rf"(?<![\w/.<-])(?:{folders})/[\w./*<>{{}},-]+"
    named = {path.rstrip(".,") for path in re.findall(ours, "\n".join(code_lines(page.read_text())))}
    patterns = [path for path in named if not set("<{") & set(path)]  # these are placeholders
    assert [path for path in patterns if not list(ROOT.glob(path))] == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_names_that_a_page_takes_from_our_packages_exist(page):
    dotted = r"(?<![\w./-])((?:scenegen|itof|render|model)\.[A-Za-z]\w*)"
    named = set(re.findall(dotted, "\n".join(code_lines(page.read_text())))) - NO_PYTHON_NAMES
    pairs = [word.split(".") for word in named]
    assert [
        (room, word)
        for room, word in pairs
        if not hasattr(importlib.import_module(room), word) and find_spec(f"{room}.{word}") is None
    ] == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_the_commands_of_a_page_have_the_options_that_it_gives_them(page):
    wrong = {}
    for words in commands(page.read_text()):
        result = CliRunner().invoke(COMMANDS[words[0]], [*words[1:], "--help"])
        if result.exit_code:
            wrong[" ".join(words)] = result.output
    assert wrong == {}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_the_benchmarks_of_a_page_have_the_options_that_it_gives_them(page):
    for line in code_lines(page.read_text()):
        called = re.match(r"\.venv/bin/python (benchmarks/\w+\.py)(.*)", line)
        if called:
            source = (ROOT / called[1]).read_text()
            words = re.findall(r"--[\w-]+", called[2])
            if re.search(r'add_argument\("\w+", choices=', source):
                words += re.findall(r"^ (\w+)", called[2])
            assert [word for word in words if f'"{word}"' not in source] == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_the_tests_that_a_page_names_exist(page):
    text = page.read_text()
    named = set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", text))
    assert len(re.findall(r"::test_", text)) == len(re.findall(r"`tests/[\w/]+\.py::test_", text))
    assert [
        f"{file}::{test}" for file, test in named if f"\ndef {test}(" not in (ROOT / file).read_text()
    ] == []


def test_each_statement_of_the_paper_has_a_mark_and_what_is_done_has_a_test_or_a_command():
    text = (ROOT / "docs/science/paper.md").read_text()
    rows = [[cell.strip() for cell in row.split(" | ")] for row in re.findall(r"^\| (.*) \|$", text, re.M)]
    statements = [row for row in rows if len(row) > 3 and re.match(r"[\d-]", row[0]) and set(row[1]) != {"-"}]
    assert len(statements) > 100
    assert [row for row in statements if len(row) != 6] == []
    marks = {row[0] for row in rows if len(row) == 2}
    wrong = []
    for _, paper, mark, _, _, where in statements:
        found = set(re.findall(r"\*[a-z]+\*", mark))
        done = found & {"*exact*", "*deviation*"}
        if not (found <= marks and (found or mark == "-")) or (
            done and not re.search(r"::test_|benchmarks/\w+\.py", where)
        ):
            wrong.append((paper, mark, where))
    assert wrong == []


def test_docstrings_cite_sections_that_the_design_page_has():
    sections = tuple(headings(ROOT / "docs/science/design.md"))
    wrong = []
    for folder in (*ROOMS, "benchmarks", "tests"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            text = re.sub(r"\s*\n\s*(# )?", " ", file.read_text())
            cited = re.findall(r"docs/science/design\.md, (.{0,40})", text) if file != Path(__file__) else []
            wrong += [f"{name(file)}: {words}" for words in cited if not words.startswith(sections)]
    assert wrong == []


def test_the_pages_that_the_code_cites_exist():
    wrong = []
    for file in PROGRAMS:
        cited = set(re.findall(r"\b(?:docs|notebook)/[\w/-]+\.md", file.read_text()))
        wrong += [f"{name(file)}: {page}" for page in sorted(cited) if not (ROOT / page).is_file()]
    assert wrong == []


def test_the_documentation_is_short_and_its_tables_are_readable():
    assert sum(len(page.read_text().split()) for page in DOCS) <= MOST_WORDS
    assert len((ROOT / "README.md").read_text().splitlines()) < 120
    cells = [(name(page), cell) for page in PAGES for cell in table_cells(page.read_text())]
    assert [cell for cell in cells if len(cell[1].strip()) > LONGEST_CELL] == []


def test_the_classes_whose_settings_the_site_lists_exist():
    places = re.findall(
        r"^::: settings (.*)\.(\w+)$", (ROOT / "docs/reference/settings.md").read_text(), re.M
    )
    assert len(places) == 3
    for module, settings in places:
        assert hasattr(getattr(importlib.import_module(module), settings), "__pydantic_fields__")


@pytest.mark.long
def test_the_site_is_built_without_warnings_and_takes_nothing_from_elsewhere(tmp_path):
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        tmp_path / "site",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = {str(file.relative_to(tmp_path / "site")): file.read_text() for file in tmp_path.rglob("*.html")}
    foreign = (
        r"<(?:script|img|iframe)[^>]* src=\"?(?:https?:)?//|<link[^>]* href=\"?(?:https?:)?//[^>]*stylesheet"
    )
    assert [page for page, text in pages.items() if re.search(foreign, text)] == []
    commands = pages["reference/commands.html"]
    assert all(f"Usage: {program} " in commands for program in COMMANDS)
    settings = pages["reference/settings.html"]
    assert all(
        key in settings for key in ("learning_rate", "camera.horizontal_fov_deg", "sensor.full_well_e")
    )
    assert "radial_depth_m" in pages["reference/python.html"]
    cameras = pages["reference/cameras.html"]
    assert all(file.stem in cameras for file in (ROOT / "data" / "captures").glob("*.toml"))
    assert "data_collect --ft raw" in cameras  # how a camera gives phases


def test_the_citation_file_has_the_version_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (str(citation["version"]), citation["license"]) == (project["version"], project["license"])
    assert f"## [{project['version']}]" in (ROOT / "CHANGELOG.md").read_text()
