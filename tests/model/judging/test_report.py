"""The report: averages by group, the mask threshold, and the page in a real browser."""

import csv
import json
import re
import shutil

import numpy as np
import pytest
import training_runs
from report_pages import AT_NIGHT, WITH_WEBGL, WITHOUT_WEBGL, Page, browse, needs_chromium
from synthetic_dataset import DISC_RADIUS_M, write_synthetic_dataset

from itof.metrics import image_metrics
from itof.pictures.figures import write_pdf
from model.data.shards import open_shards
from model.judging.evaluation import EvaluationError, evaluate
from model.judging.report.chart_png import chart_figure
from model.judging.report.charts import training_curves
from model.prediction.predictor import load
from model.run_folder.run_config import RunError
from model.training.loop import train
from scenegen import open_dataset

PICTURES = {"best", "median", "worst", "scenes", "point_clouds"}  # figures that are not charts

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=24)


@pytest.fixture(scope="module")
def run(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    learning = {"width": 4, "batch_size": 4, "max_epochs": 2, "learning_rate": 2e-3, "dead_zone": 0.02}
    train(dataset, folder, training_runs.settings(**learning, **training_runs.FLIP))
    return folder


@pytest.fixture(scope="module")
def judged(run, dataset, tmp_path_factory):
    """A report of the training scenes, the most there are, and its folder."""
    folder = tmp_path_factory.mktemp("reports") / "report"
    return evaluate(run, dataset, folder, split="train", device="cpu", progress=False), folder


def test_averages_of_groups_are_those_done_by_hand(judged_run, closed_form_scenes):
    report, folder = judged_run
    with (folder / "metrics.csv").open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    for line in lines:  # what explains a scene is what its description says
        scene = closed_form_scenes.scene(line["scene"])
        assert line["object_class"] == scene.object_class
        assert line["composite"] == str(int(len(scene.hidden_objects) > 1))
        assert float(line["roughness"]) == scene.relay_wall.roughness
        location_m = tuple(float(line[name]) for name in ("x_m", "y_m", "z_m"))
        assert location_m == scene.hidden_objects[0].location_m

    def averages(chosen):
        return {
            "count": len(chosen),
            "depth_mae_m": np.mean([float(line["depth_mae_m"]) for line in chosen]),
            "miou": np.mean([float(line["miou"]) for line in chosen]),
            "no_object_mae_m": np.mean([float(line["no_object_mae_m"]) for line in chosen]),
        }

    def found(key, place):
        group = json.loads((folder / "metrics.json").read_text())["groups"][key][place]
        return {name: group[name] for name in ("count", "depth_mae_m", "miou", "no_object_mae_m")}

    names = sorted({line["object_class"] for line in lines})
    for place, name in enumerate(names):
        chosen = [line for line in lines if line["object_class"] == name]
        assert found("object_class", place) == pytest.approx(averages(chosen))
    far = [line for line in lines if float(line["x_m"]) >= 1.225]  # the last quarter of 1.0 .. 1.3 m
    assert found("x_m", -1) == pytest.approx(averages(far))
    edge = np.quantile([int(line["object_pixels"]) for line in lines], 0.25)
    small = [line for line in lines if int(line["object_pixels"]) <= edge]
    assert found("object_pixels", 0) == pytest.approx(averages(small))
    for table in report.groups:
        assert sum(group.count for group in table.groups) == len(lines), table.key


@pytest.mark.long
def test_the_sweep_at_the_threshold_in_use_is_the_report(judged, run, dataset, tmp_path):
    report, _ = judged
    assert report.calibration.judged_threshold == 0.5
    assert report.calibration.judged.at(0.5).miou == pytest.approx(report.prediction.miou.mean, rel=1e-12)
    assert report.calibration.judged.at(0.5).depth_mae_m == pytest.approx(
        report.prediction.depth_mae_m.mean, rel=1e-9
    )
    other = evaluate(
        *(run, dataset, tmp_path / "report"), split="train", device="cpu", progress=False, mask_threshold=0.33
    )
    swept = other.calibration.judged.at(0.33)
    assert swept.miou == pytest.approx(other.prediction.miou.mean, rel=1e-12)
    assert other.calibration.judged.at(0.5) == report.calibration.judged.at(0.5)
    assert swept.miou != report.prediction.miou.mean
    written = json.loads((tmp_path / "report" / "metrics.json").read_text())
    assert (written["mask_threshold"], written["run_mask_threshold"]) == (0.33, 0.5)
    assert "judged with mask threshold 0.33 (the run's own is 0.5)" in other.table
    assert "judged with mask threshold 0.33" in (tmp_path / "report" / "index.html").read_text()


@pytest.mark.long
def test_without_validation_scenes_only_the_judged_split_is_swept(run, dataset, tmp_path):
    none = {"count": 4, "test_fraction": 0.5, "validation_fraction": 0.0}
    plain = write_synthetic_dataset(tmp_path / "data", count=4, dataset=none)
    report = evaluate(run, plain, tmp_path / "report", device="cpu", progress=False)
    assert report.calibration.validation is None
    assert list(json.loads((tmp_path / "report" / "metrics.json").read_text())["calibration"]) == ["test"]
    assert "no validation scenes" in (tmp_path / "report" / "index.html").read_text()
    both = evaluate(run, dataset, tmp_path / "both", device="cpu", progress=False).calibration
    assert both.validation is not None
    assert (both.judged.split, both.validation.split) == ("test", "validation")


@pytest.mark.long
def test_a_run_at_one_frequency_is_judged_on_a_dataset_of_three(dataset, tmp_path):
    learning = {"width": 2, "batch_size": 4, "max_epochs": 1, "frequencies_hz": (50e6,)}
    train(dataset, tmp_path / "run", training_runs.settings(**learning, **training_runs.FLIP))
    report = evaluate(tmp_path / "run", dataset, tmp_path / "report", device="cpu", progress=False)
    shards = open_shards(dataset)
    block = shards.read(shards.rows("test"))
    seen = load(tmp_path / "run", "cpu").predict(
        block.phasors[..., 1:2],
        shards.reference[..., 1:2],  # 20, *50*, 60 MHz
    )
    views = zip(seen.radial_depth_m, seen.mask, block.radial_depth_m, block.mask, strict=True)
    assert [scene.prediction for scene in report.scenes] == [image_metrics(*view) for view in views]


@pytest.mark.parametrize("threshold", [0.0, -1.0, float("nan"), float("inf")])
def test_a_threshold_that_is_no_amplitude_is_refused(finished_run, closed_form_scenes, tmp_path, threshold):
    with pytest.raises(EvaluationError, match="an amplitude above 0"):
        evaluate(
            finished_run, closed_form_scenes, tmp_path / "report", progress=False, mask_threshold=threshold
        )
    assert not (tmp_path / "report").exists()


def test_the_summary_in_markdown_has_a_line_for_every_shape_and_wall(judged_run):
    report, folder = judged_run
    text = (folder / "summary.md").read_text()
    tables = {table.key: table for table in report.groups}
    for group in (*tables["object_class"].groups, *tables["roughness"].groups):
        assert f"| {group.name} | {group.count} | {100 * group.depth_mae_m:.2f} |" in text
    widths = [line.count("|") for line in text.splitlines() if line.startswith("|")]
    assert set(widths) == {7}


def test_the_page_refers_to_nothing_on_the_network(judged_run):
    page = Page((judged_run[1] / "index.html").read_text())
    assert page.references
    assert [r for r in page.references if not r.startswith(("#", "data:"))] == []
    ours = "".join(page.scripts + page.styles)
    assert re.search(r"https?:|//\w+\.|@import|fetch\(|XMLHttpRequest|import\(|WebSocket", ours) is None
    assert [u for u in re.findall(r"url\(([^)]*)\)", ours) if not u.startswith("#")] == []
    # Plotly could load maps and the like; the browser is told to refuse.
    assert page.policy.startswith("default-src 'none'")
    assert "http" not in page.policy
    assert "connect-src" not in page.policy
    assert {"link", "iframe", "object", "embed", "base"} & set(page.tags) == {"link"}  # an empty icon


def names_of_charts(folder):
    return {file.stem for file in (folder / "figures").iterdir()} - PICTURES


def test_every_chart_of_the_page_is_a_png_too_and_has_the_numbers_of_the_report(judged_run):
    report, folder = judged_run
    page = Page((folder / "index.html").read_text())
    charts = page.data["chart-data"]
    assert set(charts) == set(page.charts) == names_of_charts(folder)
    assert len(charts) == 10
    histogram = charts["miou_histogram"]
    nothing, ours = (part for part in histogram["parts"] if part["kind"] == "bars")
    assert sum(nothing["counts"]) == sum(ours["counts"]) == len(report.scenes)
    assert ours["name"] == f"prediction, mean {report.prediction.miou.mean:.3g}"
    values = [result.prediction.miou for result in report.scenes]
    assert ours["counts"] == np.histogram(values, ours["edges"])[0].tolist()
    averages = [part["x"] for part in histogram["parts"] if part["kind"] == "upright"]
    assert averages == pytest.approx([report.no_object.miou.mean, report.prediction.miou.mean])
    curve = next(part for part in charts["calibration_miou"]["parts"] if part["kind"] == "curve")
    assert curve["y"][curve["x"].index(0.5)] == report.calibration.judged.at(0.5).miou


def test_every_figure_is_a_pdf_too_with_the_same_bytes_each_time(judged_run, tmp_path):
    _, folder = judged_run
    figures = sorted((folder / "figures").iterdir())
    assert sorted(file.stem for file in figures if file.suffix == ".pdf") == sorted(
        file.stem for file in figures if file.suffix == ".png"
    )
    assert all(file.read_bytes().startswith(b"%PDF") for file in figures if file.suffix == ".pdf")
    (loss,) = training_curves({"epoch": [1.0, 2.0], "train_loss": [2.0, 1.0], "validation_loss": [3.0, 1.0]})
    files = [tmp_path / "once.pdf", tmp_path / "again.pdf"]
    for file in files:
        write_pdf(file, chart_figure(loss))
    once, again = (file.read_bytes() for file in files)
    assert once == again
    assert b"/CreationDate" not in once
    assert b"/FontFile2" in once  # TrueType


def test_a_history_with_gaps_and_missing_columns_still_makes_charts():
    full = {"epoch": [1.0, 2.0], "train_loss": [2.0, float("nan")], "validation_loss": [3.0, 1.0]}
    (loss,) = training_curves(full)
    assert [part.name for part in loss.parts] == ["training", "validation", "kept: epoch 2"]
    assert loss.parts[0].y == (2.0, None)
    losses, uncertainty = [0.5, 0.6, 0.9], [0.1, 0.4, 0.8]
    trained = {"epoch": [1.0, 2.0, 3.0], "train_loss": losses, "validation_loss": losses}
    trained["validation_uncertainty"] = uncertainty
    (compared,) = training_curves(trained)
    assert compared.parts[-1].name == "kept: epoch 3"
    (bare,) = training_curves({"epoch": [1.0], "validation_miou": [0.5]})  # one epoch, nothing to name
    assert [(part.name, part.style) for part in bare.parts] == [("", "dots")]
    for chart in (loss, bare):
        json.dumps(chart.as_data(), allow_nan=False)
        (axes,) = chart_figure(chart).axes
        assert (axes.get_legend() is None) == (chart is bare)
    assert training_curves({"epoch": []}) == training_curves({}) == ()


@pytest.fixture(scope="module")
def hostile(run, dataset, tmp_path_factory):
    """A report of a run and of scenes whose names are an attack."""
    evil = "\"onerror=\"document.title='evil'\"><script>document.title='evil'</script>$&|`{{ 7 * 7 }}"
    root = tmp_path_factory.mktemp("hostile")
    shutil.copytree(run, root / evil.replace("/", "-"))
    shutil.copytree(dataset.root, root / "data")
    for file in [root / "data" / "dataset.json", *(root / "data" / "scenes").glob("*/scene.json")]:
        named = f'"object_class": {json.dumps(evil)}'
        file.write_text(re.sub(r'"object_class": "\w+"', lambda _: named, file.read_text()))  # noqa: B023
    out = root / "report"
    hostile_run = root / evil.replace("/", "-")
    evaluate(hostile_run, open_dataset(root / "data"), out, device="cpu", progress=False)
    return evil, out


@pytest.mark.long
def test_hostile_names_are_text_and_nothing_else(hostile, judged):
    evil, out = hostile
    text = (out / "index.html").read_text()
    assert evil not in text
    assert evil.replace("/", "-") not in text
    page, harmless = Page(text), Page((judged[1] / "index.html").read_text())
    assert evil in page.text  # the class
    assert evil.replace("/", "-") in page.text  # the run's folder
    assert sum(evil in value for name, value in page.attributes if name == "aria-label") == 5
    assert page.tags.count("script") == harmless.tags.count("script")
    assert {name for name, _ in page.attributes} == {name for name, _ in harmless.attributes}
    summary = (out / "summary.md").read_text()
    assert "<script" not in summary
    rows = [line for line in summary.splitlines() if line.startswith("|")]
    assert {line.count("|") - line.count("\\|") for line in rows} == {7}


def assert_drawn(page):
    """Every chart is there as plotly drew it, with its axes, its names and all of its points."""
    assert set(page.data["chart-data"]) == set(page.charts)
    for name, chart in page.data["chart-data"].items():
        assert page.drawn[name] == "plotly"
        drawn, parts = page.charts[name], chart["parts"]
        assert (drawn["xtitle"], drawn["ytitle"]) == ([chart["x_label"]], [chart["y_label"]])
        assert sorted(drawn["legendtext"]) == sorted(part["name"] for part in parts if part["name"])
        marked = [
            part
            for part in parts
            if part["kind"] == "bars" or part.get("style") in {"dots", "points", "rings"}
        ]
        assert len(drawn["point"]) >= sum(len(part["y" if "y" in part else "counts"]) for part in marked)
        assert len(drawn["js-line"]) >= sum(part.get("style") == "line" for part in parts)


def clouds(page):
    return [how for name, how in page.drawn.items() if name.isdigit()]


@pytest.mark.long
@needs_chromium
def test_a_browser_draws_charts_and_point_clouds_without_an_error(hostile, tmp_path):
    document, console = browse(hostile[1] / "index.html", tmp_path, WITH_WEBGL)
    page = Page(document)
    assert clouds(page) == ["plotly"] * 3
    assert page.tags.count("canvas") == 4  # with that of every scene
    assert page.drawn["every scene"] == "0"
    assert_drawn(page)
    assert "data-errors" not in document.split("<head")[0]
    bad = [
        line for line in console if re.search(r"error|refused|violat|uncaught|failed", line, re.IGNORECASE)
    ]
    assert bad == []
    assert "<title>evil" not in document


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize(("scheme", "blue"), [((), "11, 111, 184"), ((AT_NIGHT,), "88, 176, 242")])
def test_a_browser_without_webgl_gets_a_sentence_and_charts_in_the_colours_of_the_page(
    judged, tmp_path, scheme, blue
):
    document, _ = browse(judged[1] / "index.html", tmp_path, WITHOUT_WEBGL, *scheme)
    page = Page(document)
    assert clouds(page) == ["no-webgl"] * 3
    assert document.count("<p>This browser offers no WebGL, so the point cloud cannot be drawn here.") == 3
    assert_drawn(page)
    blues = set(re.findall(r"fill: rgb\((11, 111, 184|88, 176, 242)\)", document))
    assert blues == {blue}
    assert "data-errors" not in document.split("<head")[0]


@pytest.fixture(scope="module")
def blind(run, tmp_path_factory):
    """A network that sees nothing, without a history."""
    folder = tmp_path_factory.mktemp("runs") / "blind"
    shutil.copytree(run, folder)
    training_runs.blind(folder)
    (folder / "history.csv").unlink()
    return folder


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize(("radius_m", "how"), [(DISC_RADIUS_M, "plotly"), (0.0, "empty")])
def test_a_network_that_sees_nothing_still_gets_a_whole_page(blind, tmp_path, monkeypatch, radius_m, how):
    monkeypatch.setattr("synthetic_dataset.DISC_RADIUS_M", radius_m)  # 0: no pixel shows an object
    none = {"count": 4, "test_fraction": 0.5, "validation_fraction": 0.0}
    data = write_synthetic_dataset(tmp_path / "data", count=4, dataset=none)
    report = evaluate(blind, data, tmp_path / "report", device="cpu", progress=False)
    assert report.prediction == report.no_object
    text = (tmp_path / "report" / "index.html").read_text()
    assert ", 0 predicted" in text
    assert "has no history.csv" in text
    assert len(names_of_charts(tmp_path / "report")) == 7
    document, _ = browse(tmp_path / "report" / "index.html", tmp_path / "p", WITH_WEBGL)
    page = Page(document)
    assert clouds(page) == [how] * 3
    assert_drawn(page)
    assert "data-errors" not in document.split("<head")[0]


def test_a_damaged_history_is_named(finished_run, closed_form_scenes, tmp_path):
    shutil.copytree(finished_run, tmp_path / "run")
    (tmp_path / "run" / "history.csv").write_text("epoch,train_loss\n1,much\n")
    with pytest.raises(RunError, match=r"history.csv is damaged"):
        evaluate(tmp_path / "run", closed_form_scenes, tmp_path / "report", device="cpu", progress=False)
    assert not (tmp_path / "report").exists()
