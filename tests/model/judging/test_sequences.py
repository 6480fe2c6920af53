"""A sequence is judged over time: charts and a film of its frames, in the report."""

import base64
import json

import pytest
from PIL import Image
from report_pages import Page
from synthetic_dataset import write_synthetic_dataset

from model.judging.evaluation import evaluate
from model.judging.report import sequence_film

pytestmark = pytest.mark.usefixtures("one_thread")
RATE_HZ, FRAMES = 5, 7
TABLE = {"shape": "sphere", "size_m": 0.2, "path_m": [[1.0, 0.7, 1.6], [1.3, 1.2, 1.6]]}


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    dataset = {"count": FRAMES, "frame_rate_hz": RATE_HZ}
    root = tmp_path_factory.mktemp("sequence")
    return write_synthetic_dataset(root, count=FRAMES, dataset=dataset, object=[TABLE])


@pytest.fixture(scope="module")
def judged(finished_run, sequence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports") / "report"
    return evaluate(finished_run, sequence, folder, device="cpu", progress=False), folder


def test_the_score_of_every_frame_is_drawn_at_its_time(judged):
    report, folder = judged
    assert json.loads((folder / "metrics.json").read_text())["frame_rate_hz"] == RATE_HZ
    assert [scene.scene for scene in report.scenes] == [f"{index:06d}" for index in range(FRAMES)]
    charts = Page((folder / "index.html").read_text()).data["chart-data"]
    error, overlap = (charts[name] for name in ("mae_over_time", "iou_over_time"))
    lines = {part["name"]: part for part in error["parts"]}
    assert lines["prediction"]["x"] == pytest.approx([index / 5 for index in range(FRAMES)])
    assert lines["prediction"]["y"] == [100 * scene.prediction.depth_mae_m for scene in report.scenes]
    assert lines["no object"]["y"] == [100 * scene.no_object.depth_mae_m for scene in report.scenes]
    assert overlap["parts"][0]["y"] == [scene.prediction.object_iou for scene in report.scenes]
    assert {f"{name}.png" for name in charts} <= {file.name for file in (folder / "figures").iterdir()}


def test_the_film_has_every_frame_and_is_in_the_page(judged):
    _, folder = judged
    with Image.open(folder / "film.gif") as film:
        assert (film.n_frames, film.info["duration"]) == (FRAMES, 1000 / RATE_HZ)
    page = (folder / "index.html").read_text()
    assert base64.b64encode((folder / "film.gif").read_bytes()).decode() in page
    assert '<a href="#sequence">' in page
    assert "film.gif" in json.loads((folder / "metrics.json").read_text())["files"]


def test_a_long_film_leaves_frames_out_and_lasts_as_long(
    judged, finished_run, sequence, tmp_path, monkeypatch
):
    monkeypatch.setattr(sequence_film, "MOST_FRAMES", 4)
    evaluate(finished_run, sequence, tmp_path / "report", device="cpu", progress=False)
    with Image.open(tmp_path / "report" / "film.gif") as film:
        assert (film.n_frames, film.info["duration"]) == (4, 2 * 1000 / RATE_HZ)


def test_other_reports_have_no_film(judged_run):
    report, folder = judged_run
    assert report.frame_rate_hz is None
    assert not (folder / "film.gif").exists()
    assert 'id="sequence"' not in (folder / "index.html").read_text()
