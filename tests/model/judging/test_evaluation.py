"""Evaluation of a run: what the report holds, what it replaces, and what is refused."""

import json
import shutil

import numpy as np
import pytest
import trimesh
from night_commands import night_here, refusal
from synthetic_dataset import write_synthetic_dataset
from training_runs import before_each_network, blind

from disk.partials import HOST
from itof import pixel_rays
from model.data.rows import RowLayout
from model.data.shards import open_shards
from model.judging.evaluation import EvaluationError, evaluate
from model.run_folder.run_config import RunError

pytestmark = pytest.mark.usefixtures("one_thread")


def judge(run, dataset, out, **options):
    return evaluate(run, dataset, out, device="cpu", progress=False, **options)


def contents(folder):
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


@pytest.mark.long
def test_evaluation_over_many_pieces_is_that_over_one(judged_run, finished_run, tmp_path, monkeypatch):
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * RowLayout(24, 14, 3).row_bytes)
    pieces = write_synthetic_dataset(tmp_path / "data", count=12)
    many = judge(finished_run, pieces, tmp_path / "many", split="train")
    assert len(open_shards(pieces).manifest.pieces) == 6
    assert many == judged_run[0]


@pytest.mark.long
def test_point_clouds_of_the_truth_lie_at_its_depth_on_the_pixels_rays(judged_run, closed_form_scenes):
    shards = open_shards(closed_form_scenes)
    row = shards.rows("train")[0]
    cloud = trimesh.load(judged_run[1] / "pointclouds" / f"{shards.ids([row])[0]}_gt.ply")
    truth = shards.read([row])
    mask = truth.mask[0] > 0
    height, width = mask.shape
    rays = pixel_rays(width, height, closed_form_scenes.preset.camera.horizontal_fov_deg)
    expected = (rays * truth.radial_depth_m[0][..., None])[mask]
    np.testing.assert_allclose(cloud.vertices, expected, rtol=1e-6, atol=1e-6)


@pytest.fixture
def earlier_report(judged_run, tmp_path):
    """Copy of that report, to be replaced."""
    return shutil.copytree(judged_run[1], tmp_path / "report")


@pytest.mark.long
def test_a_network_that_sees_nothing_scores_the_baseline_and_draws_no_points(
    finished_copy, closed_form_scenes, earlier_report
):
    blind(finished_copy)
    report = judge(finished_copy, closed_form_scenes, earlier_report)
    assert report.prediction == report.no_object
    # Nothing of the earlier report of another split is left.
    clouds = {file.name for file in (earlier_report / "pointclouds").iterdir()}
    assert clouds == {f"{scene}_gt.ply" for scene in closed_form_scenes.ids("test")}


INSIDE = ("notes.txt", "figures/thesis.txt", "figures/thesis.png", "pointclouds/000000_mine.ply")


@pytest.mark.parametrize("mine", INSIDE)
def test_a_report_replaces_no_file_that_the_user_put_into_an_earlier_one(
    closed_form_scenes, earlier_report, tmp_path, mine
):
    (earlier_report / mine).write_text("years of work")
    before = contents(earlier_report)
    # The missing run is not noticed: the folder is checked first.
    with pytest.raises(EvaluationError, match=f"an earlier report: {mine}; move"):
        judge(tmp_path / "no run", closed_form_scenes, earlier_report)
    assert contents(earlier_report) == before


def test_a_report_follows_no_link_in_an_earlier_one(closed_form_scenes, earlier_report, tmp_path):
    figures = (earlier_report / "figures").rename(tmp_path / "figures")
    (earlier_report / "figures").symlink_to(figures)
    with pytest.raises(EvaluationError, match="an earlier report: figures/; move"):
        judge(tmp_path / "no run", closed_form_scenes, earlier_report)
    assert any(figures.iterdir())


@pytest.mark.long
def test_a_file_that_the_user_adds_while_a_report_is_made_stays(
    finished_run, closed_form_scenes, earlier_report
):
    mine = earlier_report / "figures" / "thesis.txt"
    with (
        before_each_network(lambda _: mine.write_text("years of work")),
        pytest.raises(EvaluationError, match=r"figures/thesis\.txt"),
    ):
        judge(finished_run, closed_form_scenes, earlier_report, split="train")
    assert mine.read_text() == "years of work"


@pytest.mark.parametrize("kind", ["run", "dataset", "foreign"])
def test_a_report_replaces_no_other_folder(finished_run, closed_form_scenes, tmp_path, kind):
    foreign = tmp_path / "foreign"
    (foreign / "figures").mkdir(parents=True)
    (foreign / "figures" / "thesis.txt").write_text("years of work")
    out = {"run": finished_run, "dataset": closed_form_scenes.root, "foreign": foreign}[kind]
    before = contents(out)
    with pytest.raises(EvaluationError, match="holds other things than an earlier report"):
        judge(tmp_path / "no run", closed_form_scenes, out)
    assert contents(out) == before


def test_a_refused_command_puts_back_a_report_that_a_kill_left_between_two_renames(
    closed_form_scenes, earlier_report, tmp_path
):
    before = contents(earlier_report)
    left = tmp_path / f".report.{HOST}-999999999.1.partial"
    left.mkdir()
    earlier_report.rename(left / "report.old")
    with pytest.raises(RunError, match="no run"):
        judge(tmp_path / "no run", closed_form_scenes, earlier_report)
    assert contents(earlier_report) == before
    assert not left.exists()


def test_an_interrupted_evaluation_leaves_the_earlier_report_as_it_was(
    finished_run, closed_form_scenes, earlier_report, tmp_path
):
    before = contents(earlier_report)

    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    with before_each_network(interrupt), pytest.raises(KeyboardInterrupt):
        judge(finished_run, closed_form_scenes, earlier_report, split="train")
    assert contents(earlier_report) == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["report"]


def test_evaluation_at_another_resolution_or_frequency_is_refused(finished_run, tmp_path):
    larger = write_synthetic_dataset(tmp_path / "larger", count=4, width=30, height=20)
    with pytest.raises(EvaluationError, match=r"trained on 24x14 pixels, .* rendered at 30x20"):
        judge(finished_run, larger, tmp_path / "report")
    slower = write_synthetic_dataset(tmp_path / "slower", count=4, itof={"frequencies_hz": [20e6, 50e6]})
    with pytest.raises(EvaluationError, match=r"trained at 20, 50, 60 MHz, .* holds 20, 50 MHz"):
        judge(finished_run, slower, tmp_path / "report")
    assert not (tmp_path / "report").exists()


def test_a_report_says_its_main_numbers_in_a_shell(judged_run):
    report, _ = judged_run
    first, second = repr(report).split("\n")
    mae_cm = 100 * np.mean([scene.prediction.depth_mae_m for scene in report.scenes])
    assert first.startswith(
        f"Report: {len(report.scenes)} scenes of the split train: MAE {mae_cm:.2f} cm, mIoU "
    )
    assert second == f"{len(report.warnings)} more in sentences"


def test_evaluation_without_a_test_split_says_which_there_are(finished_run, tmp_path):
    tables = {"count": 4, "test_fraction": 0.0, "validation_fraction": 0.5}
    dataset = write_synthetic_dataset(tmp_path / "data", count=4, dataset=tables)
    with pytest.raises(EvaluationError, match="has no test split: its 4 scenes are train and validation"):
        judge(finished_run, dataset, tmp_path / "report")


@pytest.mark.long
def test_night_eval_judges_where_no_other_command_is_named(finished_run, closed_form_scenes, tmp_path):
    data, cpu = closed_form_scenes.root, ("--device", "cpu")
    empty = tmp_path / "empty"
    empty.mkdir()
    done = night_here("night-eval", "--out", ".", *cpu, finished_run, data, "--json", cwd=empty)
    assert done.returncode == 0, done.stderr
    assert "no object" in done.stderr
    assert json.loads(done.stdout) == json.loads((empty / "metrics.json").read_text())
    # All orders of words reach the same command with the same values: it refuses this threshold.
    bad, out = ("--mask-threshold", "inf"), ("--out", tmp_path / "report")
    messages = {
        refusal("night-eval", *words)
        for words in (
            (finished_run, data, *out, *bad),
            (*out, *bad, finished_run, data),
            ("judge", finished_run, data, *out, *bad),
        )
    }
    assert len(messages) == 1
    assert "an amplitude above 0, got inf" in messages.pop()
    assert "Missing argument 'DATASET'" in refusal("night-eval", finished_run)
    zero = refusal("night-eval", finished_run, data, *out, "--mask-threshold", 0)
    assert "not in the range x>0" in zero
