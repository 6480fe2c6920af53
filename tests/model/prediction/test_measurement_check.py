"""Measurements of something else than the run's wall: refused in a sentence, or predicted with --force."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measurements import FREQUENCIES_HZ, write_npz
from night_commands import night_here, refusal
from wall_measurements import DEFECTS, farther, noise

import model
from itof.files.measurement_files import Measurement
from itof.wall.check_result import FileFinding
from model.prediction.measurement_check import MOST_REFUSED, check_measured
from model.prediction.prediction_files import PREDICTION_SCHEMA, predict_file
from model.prediction.predictor import load

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def predictor(seeing_run):
    return load(seeing_run, "cpu")


@pytest.fixture(scope="module")
def wall(predictor):
    return predictor.wall


def checked(predictor, phasors, reference=None, **options):
    images = phasors if phasors.ndim == 4 else phasors[None]
    measured = Measurement(Path("m.npz"), images, FREQUENCIES_HZ, reference, in_training_unit=False)
    return check_measured(predictor, measured, **{"rescale": True} | options)


def record_of(out):
    return json.loads((out / "prediction.json").read_text())


@pytest.mark.long
def test_a_measurement_of_something_else_is_refused_unless_forced(seeing_run, phasors, wall, tmp_path):
    npz = write_npz(tmp_path / "m.npz", phasors=phasors[0].conj())
    command = ("night-eval", "predict", seeing_run, npz, "--out", tmp_path / "out", "--device", "cpu")
    words = "the phase falls with distance: conjugate?"
    message = f"{npz} is not what {seeing_run} was trained on: {words}; with --force (force=True) it is "
    assert refusal(*command) == f"{message}predicted all the same"
    assert not (tmp_path / "out").exists()
    done = night_here(*command, "--force")
    assert done.returncode == 0, done.stderr
    assert f"warning: {words}\n" in done.stderr
    assert done.stdout.startswith(
        "reference: computed from the camera and the wall of the run\nimage 000000: "
    )
    record = record_of(tmp_path / "out")
    finding = {"code": "convention", "sentence": words, "refused": True, "images": ["000000"]}
    assert record["findings"][0] == finding
    assert record["images"][0]["wall"] is None


@pytest.mark.long
def test_the_command_says_what_the_wall_was_compared_with(seeing_run, phasors, wall, tmp_path):
    out = ("--out", tmp_path / "out", "--device", "cpu", "--force")  # it has seen a few scenes only
    little = write_npz(tmp_path / "a.npz", phasors=farther(phasors[0], wall, 0.003))
    done = night_here("night-eval", "predict", seeing_run, little, *out)
    assert done.returncode == 0, done.stderr
    assert "warning: the wall is not where the run has it, but 3." in done.stderr
    reference, place, *_ = done.stdout.splitlines()
    assert reference == "reference: computed from the camera and the wall of the run"
    assert place.startswith("the wall is found 3.")
    assert place.endswith(" mm (mean along the rays) from where the run has it")
    record = record_of(tmp_path / "out")
    found = record["findings"][0]
    assert (found["code"], found["refused"]) == ("wall-moved", False)
    off_m = record["images"][0]["wall"]["distance_shift_m"] - 0.003
    assert abs(off_m) < 1.2e-3  # 3 mrad of hidden light at 60 MHz
    assert (record["schema_version"], record["ignored"]) == (PREDICTION_SCHEMA, [])

    arrays = {"phasors": phasors[0], "reference": wall.direct, "ref": phasors[1], "note": np.array("mine")}
    compared = write_npz(tmp_path / "b.npz", **arrays)
    done = night_here("night-eval", "predict", seeing_run, compared, *out, "--force")
    assert done.returncode == 0, done.stderr
    assert "warning: the wall" not in done.stderr
    reference, place, ignored, *_ = done.stdout.splitlines()
    assert reference == "reference: measured (the array reference)"
    assert place.endswith(" mm (mean along the rays) from where the reference has it")
    read = "phasors, frequencies_hz, reference and horizontal_fov_deg are read"
    assert ignored == f"ignored arrays: ref, note; only {read}"
    record = record_of(tmp_path / "out")
    assert (record["reference"], record["ignored"]) == ("measured", ["ref", "note"])
    assert record["reference_wall"] is None  # of channels that calibrate themselves only


def test_a_rendered_file_can_be_checked_alone(seeing_run, exr):
    check = model.check_file(str(seeing_run), str(exr), device="cpu")
    assert (check.findings, check.refused, check.ignored, check.measured_reference) == ((), False, (), False)
    assert check.walls[0].mean_shift_m < 1.2e-3  # 3 mrad of hidden light at 60 MHz


def test_no_error_is_expected_after_a_warning(tmp_path):
    wall = load("night-40x30", "cpu").wall
    file = write_npz(tmp_path / "m.npz", phasors=farther(wall.direct, wall, 0.1))  # an empty corner
    done = predict_file("night-40x30", file, tmp_path / "out", force=True, device="cpu", progress=False)
    (doubtful,) = done.images
    assert (doubtful.expected_mae_m, doubtful.expected_depth_error_m) == (None, None)
    assert "after the warning, its error is unknown" in doubtful.sentence
    assert "expected MAE" not in doubtful.sentence
    one = replace(doubtful, expected_mae_m=0.01, doubted=False)
    moved = replace(done.check, findings=(FileFinding("wall-moved", "it is", False, ("000001",)),))
    assert one.after(moved) == one  # the finding is about the other image
    of_the_reference = replace(moved, findings=(replace(moved.findings[0], images=()),))
    assert one.after(of_the_reference).expected_mae_m is None


@pytest.mark.parametrize("name", ["noise", "ones", "20 and 60", "negative", "columns", "5 cm farther"])
def test_a_run_knows_what_its_wall_looks_like(predictor, phasors, wall, name):
    spoil, code, words = DEFECTS[name]
    check = checked(predictor, np.ascontiguousarray(spoil(phasors[0], wall)))
    assert check.refused
    assert code in [finding.code for finding in check.findings]
    assert words in "; ".join(check.warnings)


def test_findings_name_their_images(predictor, phasors):
    check = checked(predictor, np.concatenate([phasors, phasors[:2].conj(), -phasors[:1]]))
    # All three have wrong conventions; the first image's sentence stands for them.
    assert [finding.images for finding in check.findings] == [("000003", "000004", "000005")]
    assert check.warnings == ("the phase falls with distance: conjugate? (image 000003 and 2 more)",)
    assert [found is None for found in check.walls] == [False, False, False, True, True, True]
    assert check.sentences[1].startswith("the wall is found in 3 of 6 images ")


def test_after_many_refused_images_the_rest_is_checked_only_if_forced(predictor, phasors):
    many = np.repeat(phasors[:1].conj(), MOST_REFUSED + 5, axis=0)
    for thorough, count in ((False, MOST_REFUSED + 1), (True, len(many))):
        (finding,) = checked(predictor, many, thorough=thorough).findings
        assert len(finding.images) == count


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d, w: d.conj(), "the reference: the phase falls with distance: conjugate?"),
        (lambda d, w: noise(d.shape), "the reference: the phases at 20, 50, 60 MHz are noise"),
        (lambda d, w: farther(d, w, 0.1), "the wall is not where the reference has it"),
    ],
)
def test_a_wrong_reference_is_refused_as_such(predictor, phasors, wall, spoil, words):
    for thorough in (False, True):
        check = checked(predictor, phasors[0], spoil(wall.direct, wall), thorough=thorough)
        assert check.refused
        assert words in check.warnings[0]


def test_another_unit_is_noted_unless_it_is_rescaled(predictor, phasors):
    (finding,) = checked(predictor, 1024 * phasors[0], rescale=False).findings
    assert (finding.code, finding.refused) == ("other-unit", False)
    assert finding.sentence.endswith("times that of the training scenes: use --rescale?")
    assert checked(predictor, 1024 * phasors[0]).findings == ()


def test_darkness_cannot_be_forced_where_it_must_be_rescaled(seeing_run, phasors, tmp_path):
    npz = write_npz(tmp_path / "m.npz", phasors=0 * phasors)
    message = refusal("night-eval", "predict", seeing_run, npz, "--out", tmp_path / "out", "--force")
    assert "holds no light at the first frequency" in message
    assert not (tmp_path / "out").exists()
