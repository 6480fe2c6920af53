"""Numbers around the paper's Table 1: the histogram of accuracy, and the error by distance."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from scene_views import shown

from model.judging.report.charts import distributions
from model.judging.results import PAPER_ACCURACY_COUNTS, accuracy_histogram

pytestmark = pytest.mark.usefixtures("one_thread")


def scenes_of(*values):
    return [SimpleNamespace(prediction=SimpleNamespace(accuracy=value)) for value in values]


def test_the_papers_histogram_has_15_bars_of_134_scenes_and_the_mean_of_its_table():
    paper = accuracy_histogram(scenes_of(0.8))
    assert len(paper.paper_counts) == len(paper.edges) - 1 == 15
    assert sum(paper.paper_counts) == 134
    # Two inner edges as they stand in the paper's plot.
    assert paper.edges[1] == pytest.approx(0.690640883954863, abs=1e-9)
    assert paper.edges[8] == pytest.approx(0.829140815635522, abs=1e-8)
    # Table 1 by our definition: ((1 - 0.0521) + 0.77) / 2; a bin is 0.02 wide, and mIoU has two digits.
    assert paper.paper_mean == pytest.approx((1 - 0.0521 + 0.77) / 2, abs=0.005)
    assert sum(PAPER_ACCURACY_COUNTS[6:14]) == 106  # "most between 80 and 95 %"


def test_scenes_outside_the_papers_bins_are_counted_and_belong_to_the_whole():
    made = accuracy_histogram(scenes_of(0.1, 0.6708, 0.68, 0.68, 0.95, 0.9677, 0.99))
    assert (made.below, made.above) == (2, 2)
    assert made.counts[0] == 2
    assert made.counts[-1] == 1
    assert sum(made.counts) == 3
    assert sum(made.shares) == pytest.approx(3 / 7)
    assert sum(made.paper_shares) == pytest.approx(1)
    ends = accuracy_histogram(scenes_of(made.edges[0], made.edges[-1]))
    assert (ends.counts[0], ends.counts[-1], ends.below, ends.above) == (1, 1, 0, 0)


def test_the_error_by_distance_is_the_mae_over_the_mean_depth_of_the_true_object():
    result = shown(truth=((2, 8), (3, 11), 2.5), prediction=((2, 8), (3, 11), 2.75)).result
    # 48 of 240 pixels are 0.25 m off: MAE 0.05 m of 2.5 m.
    assert result.by_distance(result.prediction) == pytest.approx(0.02, rel=1e-12)
    assert result.by_distance(result.no_object) == pytest.approx(48 / 240, rel=1e-12)
    empty = shown(truth=((0, 0), (0, 0), 0.0)).result
    assert empty.object_distance_m is None
    assert empty.by_distance(empty.prediction) is None


def test_report_table_and_chart_have_the_numbers_of_the_scenes(judged_run):
    report, out = judged_run
    written = json.loads((out / "metrics.json").read_text())
    with (out / "metrics.csv").open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    ratios = [float(line["depth_mae_m"]) / float(line["object_distance_m"]) for line in lines]
    assert [float(line["relative_mae"]) for line in lines] == pytest.approx(ratios, rel=1e-12)
    assert written["relative_mae"]["prediction"]["mean"] == pytest.approx(np.mean(ratios), rel=1e-12)
    # The truth is a disc at one depth, so "no object" errs by that depth on its pixels.
    pixels = [int(line["object_pixels"]) for line in lines]
    assert written["relative_mae"]["no_object"]["mean"] == pytest.approx(
        np.mean(pixels) / (24 * 14), rel=1e-6
    )
    assert f"{100 * np.mean(ratios):.3f}" in next(
        line for line in report.table.splitlines() if line.startswith("MAE / object distance, %  prediction")
    )
    assert (
        "| MAE / object distance, % | paper, own data | 1 to 2 | - | - | - |"
        in (out / "summary.md").read_text()
    )
    histogram = written["accuracy_histogram"]
    assert sum(histogram["counts"]) + histogram["below"] + histogram["above"] == len(lines)
    chart = distributions(report)[-1]
    paper, ours = (part for part in chart.parts if hasattr(part, "counts"))
    assert paper.edges == ours.edges == tuple(histogram["edges"])
    assert paper.counts == pytest.approx([100 * count / 134 for count in PAPER_ACCURACY_COUNTS])
    assert ours.counts == pytest.approx([100 * count / len(lines) for count in histogram["counts"]])
    outside = histogram["below"] + histogram["above"]
    assert (f"; {outside} of {len(lines)} outside" in ours.name) == (outside > 0)
