"""The report: averages by group, the sweep of the mask threshold, and the page in a real browser."""

import csv
import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from synthetic_dataset import write_synthetic_dataset

from itof import phasor_of_return
from model.data.shards import open_shards
from model.network.metrics import image_metrics
from model.network.readout import Readout
from model.prediction.predictor import load, read_output
from model.report.calibration import SWEEP, ThresholdSweep, output_of
from model.report.evaluation import EvaluationError, evaluate
from model.run_folder import RunError
from model.settings import TrainSettings
from model.training.loop import train
from scenegen import open_dataset

CHROMIUM = shutil.which("chromium")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--virtual-time-budget=20000"),
    *("--enable-logging=stderr", "--v=0", "--window-size=1280,1000"),
)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's package chromium")


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=24)


@pytest.fixture(scope="module")
def run(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    learning = {"width": 4, "batch_size": 4, "max_epochs": 2, "learning_rate": 2e-3, "dead_zone": 0.02}
    train(dataset, folder, TrainSettings(**learning, progress=False, device="cpu"))
    return folder


@pytest.fixture(scope="module")
def judged(run, dataset, tmp_path_factory):
    """A report of the training scenes, the most there are, and its folder."""
    folder = tmp_path_factory.mktemp("reports") / "report"
    return evaluate(run, dataset, folder, split="train", device="cpu", progress=False), folder


def test_averages_of_groups_are_those_done_by_hand(judged, dataset):
    report, folder = judged
    with (folder / "metrics.csv").open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    for line in lines:  # what explains a scene is what its description says
        scene = dataset.scene(line["scene"])
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


def test_every_point_of_a_sweep_is_what_judging_at_it_gives():
    rng = np.random.default_rng(7)
    shape = (3, 5, 8)
    phasor = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    phasor = (0.5 * phasor).astype(np.complex64)
    truth_m = np.where(rng.random(shape) < 0.3, 2.5, 0.0).astype(np.float32)
    truth_m[2] = 0  # a scene without object
    readout = Readout(20e6)
    sweep = ThresholdSweep("test", SWEEP, readout)
    sweep.add(phasor, truth_m, (truth_m > 0).astype(np.uint8))
    for point in sweep.curve().points:
        depth_m, mask, _ = read_output(output_of(phasor), replace(readout, mask_threshold=point.threshold))
        each = [image_metrics(*images) for images in zip(depth_m, mask, truth_m, truth_m > 0, strict=True)]
        assert point.miou == pytest.approx(np.mean([m.miou for m in each]), rel=1e-12)
        assert point.depth_mae_m == pytest.approx(np.mean([m.depth_mae_m for m in each]), rel=1e-6)


def test_the_sweep_finds_the_threshold_that_parts_object_from_background():
    # Amplitude 0.72 on the object and 0.68 beside it: of the thresholds swept only 0.70 parts them.
    truth = np.zeros((1, 6, 9), dtype=np.uint8)
    truth[0, 2:4, 3:7] = 1
    amplitude = np.where(truth > 0, 0.72, 0.68)
    phasor = (amplitude * phasor_of_return(np.full(truth.shape, 2.0), 20e6)).astype(np.complex64)
    sweep = ThresholdSweep("validation", SWEEP, Readout(20e6, dead_zone=0.0))
    sweep.add(phasor, (2.0 * truth).astype(np.float32), truth)
    best = sweep.curve().best
    assert (best.threshold, best.miou) == (0.7, 1.0)
    assert best.depth_mae_m == pytest.approx(0.0, abs=1e-5)


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


def test_a_run_at_one_frequency_is_judged_on_a_dataset_of_three(dataset, tmp_path):
    learning = {"width": 2, "batch_size": 4, "max_epochs": 1, "frequencies_hz": (50e6,)}
    train(dataset, tmp_path / "run", TrainSettings(**learning, progress=False, device="cpu"))
    report = evaluate(tmp_path / "run", dataset, tmp_path / "report", device="cpu", progress=False)
    shards = open_shards(dataset)
    block = shards.read(shards.rows("test"))
    seen = load(tmp_path / "run", "cpu").predict(
        block.complex_phasors()[..., 1:2],
        shards.reference[..., 1:2],  # 20, *50*, 60 MHz
    )
    views = zip(seen.radial_depth_m, seen.mask, block.radial_depth_m, block.mask, strict=True)
    assert [scene.prediction for scene in report.scenes] == [image_metrics(*view) for view in views]


@pytest.mark.parametrize("threshold", [0.0, -1.0, float("nan"), float("inf")])
def test_a_threshold_that_is_no_amplitude_is_refused(run, dataset, tmp_path, threshold):
    with pytest.raises(EvaluationError, match="an amplitude above 0"):
        evaluate(run, dataset, tmp_path / "report", progress=False, mask_threshold=threshold)
    assert not (tmp_path / "report").exists()


def test_the_summary_in_markdown_has_a_line_for_every_shape_and_wall(judged):
    report, folder = judged
    text = (folder / "summary.md").read_text()
    tables = {table.key: table for table in report.groups}
    for group in (*tables["object_class"].groups, *tables["roughness"].groups):
        assert f"| {group.name} | {group.count} | {100 * group.depth_mae_m:.2f} |" in text
    widths = [line.count("|") for line in text.splitlines() if line.startswith("|")]
    assert set(widths) == {7}


class Page(HTMLParser):
    """What a page refers to, which elements it has, and its text but for scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.references, self.tags, self.policy, self.text = [], [], "", ""
        self.scripts, self.styles, self._inside = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append(tag)
        self._inside = "plotly" if given.get("id") == "plotly" else tag
        for name, value in attributes:
            if name in {"src", "href", "xlink:href", "srcset", "action", "data", "poster", "formaction"}:
                self.references.append(value)
            if name == "style":
                self.styles.append(value)
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"]

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside == "script":
            self.scripts.append(data)
        elif self._inside == "style":
            self.styles.append(data)
        elif self._inside != "plotly":
            self.text += data


def test_the_page_refers_to_nothing_on_the_network(judged):
    page = Page((judged[1] / "index.html").read_text())
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


@pytest.fixture(scope="module")
def hostile(run, dataset, tmp_path_factory):
    """A report of a run and of scenes whose names are an attack."""
    evil = "<script>document.title='evil'</script>$&|`"
    root = tmp_path_factory.mktemp("hostile")
    shutil.copytree(run, root / evil.replace("/", "-"))
    shutil.copytree(dataset.root, root / "data")
    for file in [root / "data" / "dataset.json", *(root / "data" / "scenes").glob("*/scene.json")]:
        file.write_text(re.sub(r'"object_class": "\w+"', f'"object_class": "{evil}"', file.read_text()))
    out = root / "report"
    hostile_run = root / evil.replace("/", "-")
    evaluate(hostile_run, open_dataset(root / "data"), out, device="cpu", progress=False)
    return evil, out


def test_hostile_names_are_text_and_nothing_else(hostile, judged):
    evil, out = hostile
    text = (out / "index.html").read_text()
    assert evil not in text
    page, harmless = Page(text), Page((judged[1] / "index.html").read_text())
    assert evil in page.text
    assert page.tags.count("script") == harmless.tags.count("script")
    summary = (out / "summary.md").read_text()
    assert "<script" not in summary
    rows = [line for line in summary.splitlines() if line.startswith("|")]
    assert {line.count("|") - line.count("\\|") for line in rows} == {7}


def browse(page, profile, *flags):
    """The page as the browser has it in the end, and what it wrote to the console."""
    done = subprocess.run(
        [CHROMIUM, *FLAGS, *flags, f"--user-data-dir={profile}", "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        check=True,
        timeout=240,
    )
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@needs_chromium
def test_a_browser_draws_the_point_clouds_without_an_error(hostile, tmp_path):
    document, console = browse(hostile[1] / "index.html", tmp_path, "--enable-unsafe-swiftshader")
    assert re.findall(r'data-drawn="([^"]*)"', document) == ["plotly"] * 3
    assert len(re.findall(r'class="gl-container"', document)) == 3
    assert "data-errors" not in document.split("<head")[0]
    bad = [
        line for line in console if re.search(r"error|refused|violat|uncaught|failed", line, re.IGNORECASE)
    ]
    assert bad == []
    assert "<title>evil" not in document


@needs_chromium
def test_a_browser_without_webgl_gets_a_sentence(judged, tmp_path):
    flags = ("--disable-3d-apis",)
    document, _ = browse(judged[1] / "index.html", tmp_path, *flags)
    assert re.findall(r'data-drawn="([^"]*)"', document) == ["no-webgl"] * 3
    assert document.count("<p>This browser offers no WebGL, so the point cloud cannot be drawn here.") == 3
    assert "data-errors" not in document.split("<head")[0]


@needs_chromium
def test_a_network_that_sees_nothing_still_gets_a_whole_page(run, tmp_path):
    none = {"count": 4, "test_fraction": 0.5, "validation_fraction": 0.0}
    data = write_synthetic_dataset(tmp_path / "data", count=4, dataset=none)
    blind = tmp_path / "blind"
    shutil.copytree(run, blind)
    weights = load_file(blind / "best.safetensors")
    last = max(name for name in weights if name.startswith("head."))
    weights |= {name: torch.zeros_like(w) for name, w in weights.items() if name[:6] == last[:6]}
    save_file(weights, blind / "best.safetensors")
    (blind / "history.csv").unlink()
    report = evaluate(blind, data, tmp_path / "report", device="cpu", progress=False)
    assert report.prediction == report.no_object
    text = (tmp_path / "report" / "index.html").read_text()
    assert ", 0 predicted" in text
    assert "has no history.csv" in text
    document, _ = browse(tmp_path / "report" / "index.html", tmp_path / "p", "--enable-unsafe-swiftshader")
    assert re.findall(r'data-drawn="([^"]*)"', document) == ["plotly"] * 3


def test_a_damaged_history_is_named(run, dataset, tmp_path):
    shutil.copytree(run, tmp_path / "run")
    (tmp_path / "run" / "history.csv").write_text("epoch,train_loss\n1,much\n")
    with pytest.raises(RunError, match=r"history.csv cannot be read"):
        evaluate(tmp_path / "run", dataset, tmp_path / "report", device="cpu", progress=False)
    assert not (tmp_path / "report").exists()
