"""Roundness of masks against closed forms, and in the report."""

import csv
import json

import numpy as np
import pytest
from scene_views import shown

from itof.metrics import summarise
from model.judging.calibration import Calibration, ThresholdCurve
from model.judging.report.chart_png import chart_figure
from model.judging.report.charts import roundness_chart
from model.judging.report_files import write_files
from model.judging.results import Report
from model.judging.scene_result import SAMPLES, disc_iou
from model.network.readout import Readout

HEIGHT, WIDTH = 90, 130


def pixels():
    """(H, W) rows and columns of the pixel centres."""
    return np.mgrid[:HEIGHT, :WIDTH].astype(float)


def segment(radius, distance):
    """Area of a disc of this radius beyond a chord at this distance from its centre."""
    return radius**2 * np.arccos(distance / radius) - distance * np.sqrt(radius**2 - distance**2)


def of_areas(inside, area):
    return inside / (2 * area - inside)


def rectangle(width, height):
    """IoU of a rectangle with the disc of equal area at its centre."""
    radius = np.sqrt(width * height / np.pi)
    beyond = sum(2 * segment(radius, side / 2) for side in (width, height) if side / 2 < radius)
    return of_areas(width * height - beyond, width * height)


def tolerance(area):
    """Error of the sampled areas, as an IoU.

    The circle of radius r cuts at most 8 r + 4 pixels. The sampled part of each is wrong by at most the
    SAMPLES-th part of a pixel for each of the two sides by which a short arc may enter: 2 / SAMPLES.
    IoU = I / (2 A - I) has the derivative 2 A / (2 A - I)^2 <= 2 / A.
    """
    return 2 / area * (8 * np.sqrt(area / np.pi) + 4) * 2 / SAMPLES


@pytest.mark.parametrize("radius", [6.0, 15.3, 33.0])
def test_a_disc_is_round(radius):
    rows, columns = pixels()
    mask = (rows - 45) ** 2 + (columns - 60) ** 2 < radius**2
    # Pixel centres decide, so the mask differs from the disc by less than one pixel for each that the circle
    # cuts, at most 8 r + 4; a quarter of a pixel on average, and both the mask and the disc lose it.
    assert disc_iou(mask) > 1 - (8 * radius + 4) / 2 / mask.sum()
    assert disc_iou(mask) <= 1


@pytest.mark.parametrize(("width", "height"), [(40, 40), (41, 41), (60, 20), (90, 6), (7, 70)])
def test_rectangles_have_the_closed_form(width, height):
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[5 : 5 + height, 11 : 11 + width] = 1
    assert disc_iou(mask) == pytest.approx(rectangle(width, height), abs=tolerance(width * height))


def test_a_square_is_less_round_than_a_disc_and_more_than_a_ring_a_bar_or_two_parts():
    corner = np.arccos(np.sqrt(np.pi) / 2)  # half the angle of the disc's segments beside a square of side 2
    shared = 4 - 16 / np.pi * (corner - np.sin(2 * corner) / 2)
    assert rectangle(1, 1) == pytest.approx(shared / (8 - shared), rel=1e-6)
    rows, columns = pixels()
    away = np.hypot(rows - 45, columns - 60)
    square = (abs(rows - 45) < 20) & (abs(columns - 60) < 20)
    # A thick ring: its disc of equal area covers the hole and the inner part of the ring.
    inner, outer = 15.0, 30.0
    area = np.pi * (outer**2 - inner**2)
    ring = of_areas(area - np.pi * inner**2, area)
    assert disc_iou((away < outer) & (away > inner)) == pytest.approx(ring, abs=tolerance(area) + 0.02)
    parts = (abs(columns - 30) < 8) | (abs(columns - 100) < 8)
    assert disc_iou(parts & (abs(rows - 45) < 8)) == 0.0  # the disc lies between them
    order = [away < 20, square, (away < outer) & (away > inner), abs(rows - 45) < 4]
    values = [disc_iou(mask) for mask in order]
    assert values == sorted(values, reverse=True)


def test_roundness_does_not_depend_on_place_and_half_turns_and_an_empty_mask_has_none():
    rng = np.random.default_rng(1)
    mask = np.zeros((30, 44), bool)
    mask[4:16, 5:25] = rng.random((12, 20)) < 0.6
    value = disc_iou(mask)
    for same in (np.roll(mask, (9, 13), (0, 1)), mask[::-1, ::-1], mask[::-1], mask.T):
        assert disc_iou(same) == pytest.approx(value, abs=1e-12)
    assert disc_iou(np.zeros((3, 5))) is None
    assert disc_iou(np.eye(1)) == pytest.approx(rectangle(1, 1), abs=tolerance(1))


def report_of(*scenes):
    """A report of scenes that are made by hand; the threshold is not swept."""
    results = tuple(scene.result for scene in scenes)
    readout = Readout(20e6, 0.5, 0.0)
    return Report(
        *("test", results, summarise([r.prediction for r in results])),
        *(summarise([r.no_object for r in results]), ()),
        Calibration(readout, readout, ThresholdCurve("test", ()), None),
    )


def test_report_and_chart_compare_the_scenes_in_which_both_show_an_object(tmp_path):
    nothing = ((0, 0), (0, 0), 0.0)
    square, bar = ((2, 8), (4, 10), 2.5), ((5, 7), (2, 17), 2.5)
    report = report_of(
        shown(truth=bar, prediction=square),
        shown("000002", truth=square, prediction=square),
        shown("000003", truth=square, prediction=nothing),
        shown("000004", truth=nothing, prediction=square),
    )
    low, high = (disc_iou(np.ones(sides)) for sides in ((2, 15), (6, 6)))
    assert report.roundness_pairs == [(high, low), (high, high)]
    assert report.roundness["prediction"].mean == pytest.approx(high)
    assert report.roundness["truth"].mean == pytest.approx((low + high) / 2)
    assert report.roundness["difference"].mean == pytest.approx((high - low) / 2)
    assert {each.count for each in report.roundness.values()} == {2}
    words = f"prediction - truth{(high - low) / 2:>9.3f}"
    assert any(
        line.startswith("roundness of the mask") and words in line for line in report.table.splitlines()
    )
    _, scenes, mean = roundness_chart(report).parts
    assert (scenes.name, list(zip(scenes.x, scenes.y, strict=True))) == (
        "2 scenes",
        [(low, high), (high, high)],
    )
    assert (mean.x[0], mean.y[0]) == pytest.approx(((low + high) / 2, high))
    write_files(tmp_path, report, {})
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert written["roundness"]["difference"]["mean"] == report.roundness["difference"].mean
    ours = [(scene["roundness_gt"], scene["roundness_pred"]) for scene in written["scenes"]]
    assert ours == [(low, high), (high, high), (high, None), (None, high)]
    with (tmp_path / "metrics.csv").open(newline="") as stream:
        assert [line["roundness_pred"] for line in csv.DictReader(stream)] == [
            str(high),
            str(high),
            "",
            str(high),
        ]


def test_without_such_a_scene_there_is_no_number_and_an_empty_chart():
    report = report_of(shown(prediction=((0, 0), (0, 0), 0.0)))
    assert set(report.roundness.values()) == {None}
    chart = roundness_chart(report)
    assert [part.name for part in chart.parts] == ["no scene in which both show an object"]
    chart_figure(chart).canvas.draw()
