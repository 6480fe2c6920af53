"""A network is judged on a corner that it does not know only when forced, and the report says so."""

import json
from dataclasses import replace

import pytest
from measurements import read_here, write_npz
from night_commands import night_here, refusal
from synthetic_dataset import write_synthetic_dataset

import model
from itof import read_image
from itof.sensor.cameras import load_sensor
from model.judging.refusals import EvaluationError
from model.judging.results import Report
from model.prediction.fields_of_view import with_fields_of_view
from scenegen import Dataset

SMALL = {"width": 24, "height": 14}
AT = (1.0, -1.0, 1.65)  # of the camera in the paper's corner, whose wall faces +x

pytestmark = pytest.mark.usefixtures("one_thread")


def scenes(root, **camera) -> Dataset:
    return write_synthetic_dataset(root, count=4, camera=SMALL | camera)


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ({"horizontal_fov_deg": 70.0}, "60 (a capture can be imported with --fov 60); "),
        ({"horizontal_fov_deg": 50.0}, "is 50 degrees, and the training saw 60; "),
        ({"location_m": [AT[0] + 0.3, *AT[1:]]}, "the wall is not where the run has it, but 30.0 cm farther"),
        (
            {"rotation_deg": [90.0, 0.0, 70.0]},
            "tilted by 20.0 degrees: the run was trained on another corner",
        ),
    ],
)
def test_scenes_of_another_corner_are_judged_only_by_force(finished_run, tmp_path, camera, words):
    data = scenes(tmp_path / "data", **camera)
    sentence = refusal("night-eval", finished_run, data.root, "--out", tmp_path / "report", "--device", "cpu")
    assert words in sentence
    assert "; night-train --for PRESET --out RUN makes a network" in sentence
    assert sentence.endswith("with --force (force=True) it is judged all the same")
    assert not (tmp_path / "report").exists()
    with pytest.raises(EvaluationError, match=r"is not what .* was trained on"):
        model.refine_split(finished_run, data, tmp_path / "refined", device="cpu", progress=False)
    with pytest.raises(EvaluationError, match=r"is not what .* was trained on"):
        model.judge_exposures(
            finished_run, data, tmp_path / "e", load_sensor("ideal"), device="cpu", progress=False
        )


def test_a_file_in_a_dataset_has_the_field_of_view_of_its_scene(tmp_path):
    data = scenes(tmp_path / "data", horizontal_fov_deg=70.0)
    image, _ = read_image(data.render_folder("000001") / "itof.exr").phasors()
    known = []
    for folder in (data.render_folder("000001"), tmp_path):
        measured = read_here(write_npz(folder / "alone.npz", phasors=image))
        measured = with_fields_of_view(measured, None)
        known.append(measured.fields_of_view_deg)
    assert known == [(70.0,), ()]


def test_what_the_training_has_not_seen_stands_in_the_report(finished_run, tmp_path):
    data = scenes(tmp_path / "data", location_m=[AT[0] + 0.05, *AT[1:]])
    done = night_here("night-eval", finished_run, data.root, "--out", tmp_path / "near", "--device", "cpu")
    assert done.returncode == 0, done.stderr  # 5 cm make predictions worse, not useless
    words = "the wall is not where the run has it, but 5.0 cm farther away"
    assert "warning: scene 00000" in done.stderr
    assert words in done.stderr
    assert words in (tmp_path / "near" / "index.html").read_text()
    assert words in (tmp_path / "near" / "summary.md").read_text()
    assert words in json.loads((tmp_path / "near" / "metrics.json").read_text())["warnings"][0]


def test_scenes_of_the_training_get_no_warning_about_their_corner(judged_run):
    report, _ = judged_run
    assert report.unlike_training == ()


def test_a_network_that_is_no_better_than_no_object_is_told_first(judged_run):
    report, folder = judged_run
    worse = replace(report.prediction, depth_mae_m=replace(report.no_object.depth_mae_m, mean=2.9))
    bad: Report = replace(report, prediction=worse)
    (words,) = bad.warnings
    assert words.startswith("the network is no better than predicting no object: its MAE is 290.0 cm, ")
    assert words.endswith(f"that of no object {100 * report.no_object.depth_mae_m.mean:.1f} cm")
    better = replace(report.prediction, depth_mae_m=replace(report.no_object.depth_mae_m, mean=1e-3))
    assert replace(report, prediction=better).warnings == ()
    assert "<h1>finished on closed_form0</h1>" in (folder / "index.html").read_text()
