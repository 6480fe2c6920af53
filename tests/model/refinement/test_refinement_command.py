"""``night-eval refine``: depth maps before and after, resumed, refused and damaged."""

import csv
import json
import shutil
import subprocess

import numpy as np
import psutil
import pytest
from night_commands import night_here, refusal, words
from PIL import Image
from render_runs import render_scenes, wait_for, workers_of
from threadpoolctl import threadpool_limits
from training_runs import edit_weights

from disk import OutsideError
from disk.preset_files import read_settings
from itof import DepthMap, read_image
from model.judging.refusals import EvaluationError
from model.prediction.explanation import Explanation, FoundSolid
from model.prediction.predictor import load
from model.refinement.figures import write_refined_figure
from model.refinement.judged_refinement import refine_split
from model.refinement.refined_result import RefinedScene, RefinementReport, SceneNumbers
from model.run_folder.shipped import run_folder
from scenegen import open_dataset

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def dataset(make_dataset):
    """Two scenes that the shipped network has not seen, rendered at its size."""
    made = make_dataset(
        {
            "dataset": {"count": 2, "seed": 91, "test_fraction": 1.0, "validation_fraction": 0.0},
            "hidden_object": {"shapes": ["cube", "sphere"], "composite_fraction": 0.0},
        }
    )
    render_scenes(made.root, product="itof", resolution=(40, 30), error=0.005)
    return made.root


@pytest.fixture(scope="module")
def refined(dataset, tmp_path_factory):
    """Folder of a finished refinement, for reading only; and what the command printed."""
    out = tmp_path_factory.mktemp("refined") / "out"
    done = night_here("night-eval", "refine", "night-40x30", dataset, "--out", out, "--device", "cpu")
    assert done.returncode == 0, done.stderr
    return out, done.stdout


@pytest.fixture
def copied(refined, tmp_path):
    return shutil.copytree(refined[0], tmp_path / "out")


def test_solids_are_found_and_their_depth_maps_are_better(refined, dataset):
    out, said = refined
    result = json.loads((out / "refined.json").read_text())
    assert "2 of 2 solids are accepted" in said
    assert result["accepted_count"] == 2
    for scene in result["scenes"]:
        (true,) = open_dataset(dataset).scene(scene["scene"]).hidden_objects
        solid = scene["found"]["solids"][0]
        assert solid["shape"] == true.shape
        # A centimetre is 0.4 % of the way, four times the error that 0.5 % of noise leaves.
        np.testing.assert_allclose(solid["location_m"], true.location_m, atol=0.01)
        assert all(0 < deviation < 0.02 for deviation in solid["location_std_m"])
        assert scene["found"]["expected_mae_m"] < scene["expected_mae_m"]
        assert scene["refined"]["depth_mae_m"] < 0.01  # of all pixels: a centimetre on the object is less
    assert result["refined"]["depth_mae_m"]["mean"] < result["network"]["depth_mae_m"]["mean"]
    with Image.open(out / "refined.png") as picture:
        assert picture.size[0] > 500
    rows = list(csv.DictReader((out / "refined.csv").read_text().splitlines()))
    assert [row["scene"] for row in rows] == ["000000", "000001"]
    assert float(rows[0]["refined_depth_mae_m"]) == result["scenes"][0]["refined"]["depth_mae_m"]


def test_the_depth_maps_are_those_that_were_judged(refined, dataset):
    out, _ = refined
    for scene in json.loads((out / "refined.json").read_text())["scenes"]:
        written = DepthMap.read(out / "scenes" / f"{scene['scene']}.exr")
        truth = DepthMap.read(dataset / "renders" / scene["scene"] / "mirrored.exr")
        error_m = np.abs(written.radial_depth_m - truth.radial_depth_m).mean(dtype=np.float64)
        assert error_m == pytest.approx(scene["refined"]["depth_mae_m"], abs=2**-22)  # float32 of 4 m


def test_what_is_finished_is_kept_and_what_is_damaged_is_made_again(copied, refined, dataset):
    first = (copied / "scenes" / "000000.json").stat().st_mtime_ns
    (copied / "scenes" / "000001.json").write_text('{"scene": "000001"')
    (copied / "refined.json").unlink()
    done = night_here("night-eval", "refine", "night-40x30", dataset, "--out", copied, "--device", "cpu")
    assert done.returncode == 0, done.stderr
    assert (copied / "scenes" / "000000.json").stat().st_mtime_ns == first
    for name in ("refined.json", "refined.csv", "scenes/000001.json", "scenes/000001.exr"):
        assert (copied / name).read_bytes() == (refined[0] / name).read_bytes()


@pytest.mark.long
def test_a_fit_that_is_not_accepted_leaves_the_networks_depth_map(dataset, tmp_path):
    done = night_here(
        *("night-eval", "refine", "night-40x30", dataset, "--out", tmp_path / "out", "--device", "cpu"),
        *("--largest-misfit", 1e-6, "--json"),
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["accepted_count"] == 0
    for scene in result["scenes"]:
        assert scene["network"] == scene["refined"]
        assert scene["found"]["misfit"] > 1e-6


def test_other_options_need_another_folder(copied, dataset):
    sentence = refusal(
        *("night-eval", "refine", "night-40x30", dataset, "--out", copied, "--device", "cpu"),
        *("--unknown", "sizes"),
    )
    assert sentence == (
        f"{copied} holds results of another run, of its earlier weights, of another dataset or of other "
        "options: choose another --out, or delete it"
    )


def test_results_of_earlier_weights_of_a_run_are_not_taken_for_its_own(copied, dataset, tmp_path):
    run = tmp_path / "night-40x30"
    shutil.copytree(run_folder("night-40x30"), run)
    edit_weights(run, lambda name, weight: 1.01 * weight)
    assert load(run).config.run_id == load("night-40x30").config.run_id
    with pytest.raises(EvaluationError, match="of its earlier weights"):
        refine_split(run, open_dataset(dataset), copied, device="cpu", progress=False)


def test_only_the_objects_of_another_preset_are_tried(dataset, tmp_path):
    objects = tmp_path / "objects.toml"
    words = ['shapes = ["sphere"]', "composite_fraction = 0.0", "size_m = { sphere = [0.5, 0.5, 0.5] }"]
    objects.write_text("\n".join(["[hidden_object]", *words]))
    done = night_here(
        *("night-eval", "refine", "night-40x30", dataset, "--out", tmp_path / "out", "--device", "cpu"),
        *("--objects", objects),
    )
    assert done.returncode == 0, done.stderr
    scenes = json.loads((tmp_path / "out" / "refined.json").read_text())["scenes"]
    found = [scene["found"] for scene in scenes]
    assert [each["solids"][0]["shape"] for each in found] == ["sphere", "sphere"]
    assert all(each["solids"][0]["size_m"] == [0.5, 0.5, 0.5] for each in found)
    assert not any(each["accepted"] for each in found)  # a cube, and a larger sphere


@pytest.mark.long
def test_a_command_that_was_killed_at_its_start_can_be_repeated(copied, refined, dataset):
    shutil.rmtree(copied / "scenes")
    refine_split("night-40x30", open_dataset(dataset), copied, device="cpu", progress=False)
    assert_same_results(copied, refined[0])


def test_a_folder_with_other_files_is_left_alone(dataset, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    sentence = refusal("night-eval", "refine", "night-40x30", dataset, "--out", tmp_path, "--device", "cpu")
    assert sentence == f"{tmp_path} holds other files: choose another --out"
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]


def test_links_in_a_started_folder_lead_nowhere(copied, dataset, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    (copied / "scenes" / "000000.json").unlink()
    (copied / "scenes" / "000000.exr").unlink()
    (copied / "scenes" / "000000.exr").symlink_to(tmp_path / "mine.txt")
    refine_split("night-40x30", open_dataset(dataset), copied, device="cpu", progress=False)
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert not (copied / "scenes" / "000000.exr").is_symlink()
    (copied / "scenes").rename(tmp_path / "elsewhere")
    (copied / "scenes").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutsideError, match="symbolic link to a place outside"):
        refine_split("night-40x30", open_dataset(dataset), copied, device="cpu", progress=False)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_what_is_accepted_is_a_number_above_0(dataset, tmp_path, value):
    sentence = refusal(
        *("night-eval", "refine", "night-40x30", dataset, "--out", tmp_path / "out"),
        *(f"--largest-misfit={value}",),
    )
    assert sentence.startswith("the largest misfit is a number above 0, got ")
    assert not (tmp_path / "out").exists()


def test_datasets_that_cannot_be_refined_are_named(dataset, closed_form_scenes, tmp_path):
    command = ("night-eval", "refine", "night-40x30")
    out = ("--out", tmp_path / "out", "--device", "cpu")
    assert "wrong resolution between stages" in refusal(*command, closed_form_scenes.root, *out)
    assert "has no train split" in refusal(*command, dataset, *out, "--split", "train")
    assert not (tmp_path / "out").exists()


def test_a_model_that_explains_no_light_asks_for_the_middle_wall():
    def said(*misfits):
        numbers = SceneNumbers(0.01, None, 0.5, 0.9)
        solid = FoundSolid("cube", *((0.5, 0.5, 0.5),) * 6)
        found = [
            None if misfit is None else Explanation((solid,), False, misfit, 0.0, 0.0, 0.01, 1.0, None)
            for misfit in misfits
        ]
        scenes = [RefinedScene("000000", "cube", numbers, numbers, None, each) for each in found]
        return RefinementReport(tuple(scenes)).sentence

    assert "solids leave 60% of the light: is the middle wall where the dataset has it?" in said(
        0.01, 0.6, 0.7
    )
    assert "middle wall" not in said(0.01, 0.02, 0.7)
    assert "middle wall" not in said(None)


def assert_same_results(out, other):
    for file in sorted(other.rglob("*")):
        if file.is_file() and file.suffix in (".json", ".csv", ".exr"):
            assert (out / file.relative_to(other)).read_bytes() == file.read_bytes(), file


@pytest.mark.long
def test_results_do_not_depend_on_the_number_of_workers(refined, dataset, tmp_path):
    given = ("--out", tmp_path / "out", "--device", "cpu", "--workers", 2)
    done = night_here("night-eval", "refine", "night-40x30", dataset, *given)
    assert done.returncode == 0, done.stderr
    assert_same_results(tmp_path / "out", refined[0])


@pytest.mark.long
@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_results_do_not_depend_on_the_number_of_threads(refined, dataset, tmp_path, threads):
    with threadpool_limits(threads):
        done = night_here(
            *("night-eval", "refine", "night-40x30", dataset, "--out", tmp_path / "out", "--device", "cpu")
        )
    assert done.returncode == 0, done.stderr
    assert_same_results(tmp_path / "out", refined[0])


@pytest.mark.long
def test_workers_end_when_their_command_is_killed(dataset, tmp_path):
    given = ("night-40x30", dataset, "--out", tmp_path / "out", "--device", "cpu", "--workers", 2)
    command = subprocess.Popen(words("night-eval", "refine", *given))
    wait_for(lambda: len(workers_of(command)) == 2)
    workers = workers_of(command)
    command.kill()
    command.wait()
    assert not psutil.wait_procs(workers, timeout=300)[1]


def test_a_mesh_of_any_name_is_drawn(refined, dataset, tmp_path):
    depth_map = DepthMap.read(refined[0] / "scenes" / "000000.exr")
    write_refined_figure(tmp_path / "a.png", [("000001 mesh:price$^$.ply", *(depth_map,) * 3)])
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size[0] > 200


@pytest.mark.long
def test_solids_are_found_where_each_scene_has_its_camera_elsewhere(make_dataset, tmp_path):
    tables, _ = read_settings("presets", "judge-any-corner")
    hidden = {
        "shapes": ["cube", "cone"],
        "composite_fraction": 0.0,
        "location_m": tables["hidden_object"]["location_m"],
    }
    made = make_dataset(
        tables
        | {"dataset": {"count": 4, "seed": 5, "test_fraction": 1.0, "validation_fraction": 0.0}}
        | {"hidden_object": hidden}
    )
    render_scenes(made.root, product="itof", resolution=(80, 60), error=0.005)
    images = [read_image(made.render_folder(each) / "itof.exr").phasors()[0] for each in made.ids()]
    assert any((image == 0).any() for image in images)  # the middle wall is in view
    report = refine_split(
        *("any-corner", open_dataset(made.root), tmp_path / "out"),
        unknown=("reflectance",),
        progress=False,
    )
    accepted = [scene for scene in report.scenes if scene.accepted]
    assert len(accepted) >= 2
    for scene in accepted:
        (true,) = made.scene(scene.scene).hidden_objects
        assert scene.found.solids[0].shape == true.shape
        # Light good to 3 % has phases good to 30 mrad, 1.2 cm at 60 MHz. Size and distance change the
        # strength, too, so the reflectance is known three times worse.
        np.testing.assert_allclose(scene.found.solids[0].location_m, true.location_m, atol=0.02)
        assert scene.found.reflectance == pytest.approx(true.reflectance, rel=0.1)
        assert scene.refined.depth_mae_m < scene.network.depth_mae_m
