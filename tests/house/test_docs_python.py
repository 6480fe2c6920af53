"""The blocks of docs/guide/python.md, run word for word as one script."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image as png

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "python.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)


def test_the_page_imports_public_names_only():
    ours = re.findall(
        r"^(?:from|import) ((?:scenegen|itof|render|model)[\w.]*)(?: import (.*))?$", "".join(BLOCKS), re.M
    )
    assert {package for package, _ in ours} == {*("scenegen", "itof", "render", "model")}
    assert not [name for _, names in ours for name in names.split(", ") if name.startswith("_")]


@pytest.mark.parametrize(
    ("scenes", "epochs", "least_share"),
    [
        pytest.param(30, 2, 0, id="small", marks=pytest.mark.long),
        pytest.param(150, 80, 0.3, id="word for word", marks=pytest.mark.thorough),
    ],
)
def test_the_page_goes_from_a_mesh_to_a_picture_of_the_prediction(tmp_path, scenes, epochs, least_share):
    check = f"""
shown_as_object = (prediction.mask & truth.mask).sum() / truth.mask.sum()
assert shown_as_object >= {least_share}, shown_as_object
assert other_z.shape == (30, 40, 2) and abs(z).min() > 0
"""
    page = "\n".join([*BLOCKS, check])
    for old, new in (('"count": 150', f'"count": {scenes}'), ('"max_epochs": 80', f'"max_epochs": {epochs}')):
        assert page.count(old) == 1
        page = page.replace(old, new)
    (tmp_path / "page.py").write_text(page)
    done = subprocess.run(
        [sys.executable, "page.py"],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{scenes} scenes in corner: ")
    panels = np.split(png.imread(tmp_path / "corner.png")[..., :3], 2, axis=1)
    assert all(panel.std() > 0.05 for panel in panels)  # none is blank
