"""The notebook of the tutorial: its cells run in an empty folder, as a notebook server runs them."""

import json
import re
import subprocess
import sys

import pytest
from source_tree import ROOT

NOTEBOOK = ROOT / "docs/tutorial/notebook.ipynb"
# As in IPython: cells share names, run inside an event loop, and end with what is shown, in its richest form.
SERVER = """
import ast, asyncio, json, sys
async def answers(names):
    for cell in json.load(open(sys.argv[1], encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            *lines, last = ast.parse("".join(cell["source"])).body
            exec(compile(ast.Module(lines, []), "cell", "exec"), names)
            found = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
            rich = [name for name in ("_repr_html_", "_repr_png_") if hasattr(found, name)]
            yield [repr(found)[:200], *(f"{name} {len(getattr(found, name)())}" for name in rich)]
async def main():
    print(json.dumps([answer async for answer in answers({"__name__": "__main__"})]))
asyncio.run(main())
"""


def test_the_notebook_holds_no_answers_and_takes_all_of_night_from_one_namespace():
    book = json.loads(NOTEBOOK.read_text())
    assert (book["nbformat"], book["nbformat_minor"]) == (4, 4)
    assert {cell["cell_type"] for cell in book["cells"]} == {"markdown", "code"}
    cells = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert [cell for cell in cells if cell["outputs"] or cell["execution_count"] is not None] == []
    imported = re.findall(r"^(?:import|from) .*", "\n".join("".join(cell["source"]) for cell in cells), re.M)
    assert imported == ["import trimesh", "import night_nlos as night"]


@pytest.mark.long
def test_the_notebook_goes_from_a_mesh_to_a_prediction_beside_the_truth_and_once_more(tmp_path):
    for _ in range(2):  # the second time among the files of the first
        command = [sys.executable, "-c", SERVER, NOTEBOOK]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    dataset, (light,), prediction, truth, (said,) = json.loads(done.stdout.splitlines()[-1])
    assert dataset[0] == "Dataset of 1 scene in around: 1 train, 0 validation, 0 test"
    assert dataset[1].startswith("_repr_html_ ")
    assert "% of the light has met the object" in light
    assert prediction[1].startswith("_repr_html_ ")
    assert truth[1].startswith("_repr_png_ ")
    found, pixels = map(int, re.match(r"'(\d+) of (\d+) object pixels are found", said).groups())
    assert 0 < found <= pixels
