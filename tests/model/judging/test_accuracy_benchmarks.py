"""Benchmarks of docs/science/accuracy.md and notebook/: bounds, library baseline, gallery."""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from statistics import mean, stdev

import numpy as np
import pytest
from PIL import Image
from training_runs import SEEING, train_on_one_thread

from itof.metrics import image_metrics, summarise
from model.data.shards import open_shards
from model.prediction.predictor import load

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def benchmarks_importable():
    sys.path.insert(0, str(BENCHMARKS))  # as if one were started
    yield
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def self_run(closed_form_scenes, tmp_path_factory):
    chosen = SEEING | {"reference": "self", "channels": "residual", "max_epochs": 2}
    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("self") / "run", **chosen)


def rows(name, *words):
    """Cells of the Markdown table that a benchmark prints, without its head."""
    command = [sys.executable, BENCHMARKS / f"{name}.py", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if re.match(r"\| *\d", line)]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_bounds_of_a_pose_are_those_of_independent_unknowns():
    bounds = runpy.run_path(str(BENCHMARKS / "pose_bound.py"))["_bounds"]
    sizes = np.array([1, 2, 4, 5, 10, 0.0])  # per metre and per radian; the last rotation changes nothing
    jacobian = np.zeros((50, 6))
    jacobian[range(6), range(6)] = sizes
    found = bounds(jacobian, np.full((50, 6), 1e-6), 1e-3)
    assert found == ("0.25 to 1.00", f"{np.degrees(1e-4):.2f} to {np.degrees(2e-4):.2f} (2 axes)")
    # Half of the first unknown's power is along the other unknown, which leaves 1 / sqrt(1 - 1/2).
    nuisance = np.zeros((50, 1))
    nuisance[[0, 40]] = 1
    assert bounds(jacobian, np.full((50, 6), 1e-6), 1e-3, nuisance)[0] == f"0.25 to {np.sqrt(2):.2f}"


@pytest.mark.long
def test_a_library_of_the_scenes_themselves_is_the_most_similar_scene(closed_form_scenes):
    count = len(open_shards(closed_form_scenes).rows("train"))
    words = (closed_form_scenes.root, "--judge", closed_form_scenes.root, "--counts", 2, count)
    ((few, *_), (many, neighbours, mae_cm, miou, _)) = rows("library_baseline", *words, "--neighbours", 1)
    assert (few, many, neighbours) == ("2", str(count), "1")
    shards = open_shards(closed_form_scenes)
    library, test = (shards.read(shards.rows(split)) for split in ("train", "test"))
    each = [
        [
            image_metrics(d, m, truth_m, mask)
            for d, m in zip(library.radial_depth_m, library.mask, strict=True)
        ]
        for truth_m, mask in zip(test.radial_depth_m, test.mask, strict=True)
    ]
    best, worst = (
        summarise([pick(one, key=lambda m: m.depth_mae_m) for one in each]).depth_mae_m.mean
        for pick in (min, max)
    )
    # The table has 0.01 cm.
    assert 100 * best - 0.01 <= float(mae_cm) <= 100 * worst + 0.01
    assert 0 < float(miou) < 1


@pytest.mark.long
def test_the_gallery_shows_the_first_scenes_and_the_worst(finished_run, closed_form_scenes, tmp_path):
    shards = open_shards(closed_form_scenes)
    ids = shards.ids(shards.rows("test"))
    words = (finished_run, closed_form_scenes.root, "--count", len(ids))
    first = rows("gallery", *words, "--out", tmp_path / "first.png")
    worst = rows("gallery", *words, "--worst", "--out", tmp_path / "worst.png")
    assert [row[0].split()[0] for row in first] == list(ids)
    errors = [float(row[1]) for row in worst]
    assert errors == sorted(errors, reverse=True)
    assert sorted(worst) == sorted(first)
    for name in ("first", "worst"):
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert picture.width > 500


@pytest.mark.long
def test_networks_are_judged_on_every_corner(self_run, closed_form_scenes):
    ours, nothing = compared(self_run, "--judge", closed_form_scenes.root)
    assert ours.startswith(f"| {self_run} | {closed_form_scenes.root.name} | ")
    shards = open_shards(closed_form_scenes)
    block = shards.read(shards.rows("test"))
    found = load(self_run, "cpu").predict(block.phasors)
    images = zip(found.radial_depth_m, found.mask, block.radial_depth_m, block.mask, strict=True)
    summary = summarise([image_metrics(*image) for image in images])
    assert float(ours.split("|")[3]) == pytest.approx(100 * summary.depth_mae_m.mean, abs=0.01)  # as printed
    assert nothing.startswith("| no object | ")


@pytest.mark.thorough
def test_runs_of_several_seeds_are_one_row_each(self_run, finished_run, closed_form_scenes, tmp_path):
    runs = [tmp_path / name for name in ("ours-0", "ours-1", "other-0")]
    for run, source in zip(runs, (self_run, finished_run, self_run), strict=True):
        shutil.copytree(source, run)
    each = compared(*runs, "--judge", closed_form_scenes.root)[:-1]
    ours, other, _ = compared(*runs, "--judge", closed_form_scenes.root, "--over-seeds")
    maes_cm = [float(row.split("|")[3]) for row in each]
    found_cm, spread_cm = (float(word) for word in ours.split("|")[3].split("±"))
    # All are rounded to 0.01 cm, which moves the difference of two by 0.01 cm at most.
    assert found_cm == pytest.approx(mean(maes_cm[:2]), abs=0.011)
    assert spread_cm == pytest.approx(stdev(maes_cm[:2]), abs=0.011)
    assert spread_cm > 0
    assert float(other.split("|")[3]) == maes_cm[2]


def compared(*words: object) -> list[str]:
    """The rows that it prints."""
    command = [sys.executable, BENCHMARKS / "compare_networks.py", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[2:]
