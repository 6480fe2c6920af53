"""Figures of several scenes: which scenes they show, and what stands in them."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from night_commands import refusal
from scene_views import HEIGHT, WIDTH, shown
from synthetic_dataset import write_synthetic_dataset

from itof.pictures.figures import svg_of
from model.judging.evaluation import EvaluationError, evaluate
from model.judging.refusals import MOST_FIGURE_SCENES
from model.judging.report.scenes_figure import scenes_figure
from model.judging.showcase import choose_for_figures
from scenegen import DatasetError, FailureRecord, write_failure

pytestmark = pytest.mark.usefixtures("one_thread")


def panels(figure):
    """Axes with an image of a scene, by row and column."""
    rows = {}
    for axes in figure.axes:
        if axes.images:  # a bar of colours has none
            rows.setdefault(round(axes.get_position().y0, 6), []).append(axes)
    return [
        sorted(row, key=lambda axes: axes.get_position().x0) for _, row in sorted(rows.items(), reverse=True)
    ]


def test_each_row_holds_re_im_and_depth_of_one_scene_with_the_truth_left_of_the_prediction():
    scenes = [shown(), shown("000007", "concave_plane", ((1, 4), (1, 5), 3.1), ((5, 9), (9, 18), 2.9))]
    rows = panels(scenes_figure(scenes, "components"))
    assert [len(row) for row in rows] == [6, 6]
    titles = [axes.get_title() for axes in rows[0]]
    assert titles == [
        f"{part}\n{whose}" for part in ("Re", "Im", "radial depth") for whose in ("truth", "prediction")
    ]
    for row, scene in zip(rows, scenes, strict=True):
        views = [scene.truth, scene.prediction]
        parts = [view.phasor.real for view in views] + [view.phasor.imag for view in views]
        parts += [np.where(view.mask, view.radial_depth_m, np.nan) for view in views]
        assert_shown(row, parts)
        name = scene.result.object_class.replace("_", " ")
        assert row[0].get_ylabel().startswith(f"{scene.result.scene}\n{name}\nrank 2 of 9\n")
    for column in zip(*rows, strict=True):
        assert column[0].images[0].get_clim() == column[1].images[0].get_clim()


def assert_shown(row, parts):
    for axes, part in zip(row, parts, strict=True):
        drawn = np.ma.filled(axes.images[0].get_array().astype(float), np.nan)
        np.testing.assert_array_equal(drawn, part)


def test_of_a_network_with_mask_and_depth_its_depth_probability_and_expected_error_are_shown():
    scenes = [shown(), shown("000007", "cube", ((1, 4), (1, 5), 3.1), ((5, 9), (9, 18), 2.9))]
    error_m = np.linspace(0.01, 0.3, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    scenes = [
        replace(
            scene,
            prediction=replace(
                scene.prediction, phasor=0.75 * scene.prediction.phasor, depth_error_m=factor * error_m
            ),
        )
        for scene, factor in zip(scenes, (1, 0.3), strict=True)
    ]
    rows = panels(scenes_figure(scenes, "mask+depth"))
    for row, scene in zip(rows, scenes, strict=True):
        answer = scene.prediction
        depths = [np.where(view.mask, view.radial_depth_m, np.nan) for view in (scene.truth, answer)]
        error_cm = np.where(answer.mask, 100 * answer.depth_error_m, np.nan)
        assert_shown(row, [*depths, np.abs(answer.phasor), error_cm])
        assert len(row[2].collections) == 1  # the outline
    limits = [[axes.images[0].get_clim() for axes in row] for row in rows]
    assert limits[0] == limits[1]
    assert limits[0][0] == limits[0][1]
    errors_cm = [100 * scene.prediction.depth_error_m[scene.prediction.mask] for scene in scenes]
    assert limits[0][2:] == [(0, 1), (0, max(each.max() for each in errors_cm))]
    unsure = [replace(scene, prediction=replace(scene.prediction, depth_error_m=None)) for scene in scenes]
    assert [len(row) for row in panels(scenes_figure(unsure, "mask+depth"))] == [3, 3]
    assert [len(row) for row in panels(scenes_figure(scenes, "depth"))] == [2, 2]


def test_on_a_page_a_figure_has_the_colours_of_the_page_and_no_style_or_name_for_the_rest_of_it():
    svg = svg_of("scenes", scenes_figure([shown()], "mask+depth"))
    assert svg.startswith("<svg ")
    for colour in ("currentColor", "var(--page)", "var(--nothing)"):
        assert colour in svg
    for word in ("#000000", "#ffffff", "<style", "<!--", "<text", '<g id="', "rank 2"):
        assert word not in svg
    other = svg_of("best", scenes_figure([shown()], "mask+depth"))
    clips = [set(re.findall(r'<clipPath id="(\w+)"', each)) for each in (svg, other)]
    assert clips[0]
    assert not clips[0] & clips[1]


def test_mae_and_miou_stand_beside_the_pictures():
    # 2 of 6 rows of the truth are missed or added, as are the columns 11 and 12:
    # truth 6 x 8 = 48, prediction 6 x 10 = 60, both 5 x 8 = 40 pixels.
    (row,) = panels(scenes_figure([shown()], "components"))
    mae_cm = 100 * (40 * 0.3 + 8 * 2.5 + 20 * 2.8) / (HEIGHT * WIDTH)
    miou = (40 / 68 + (240 - 68) / (240 - 40)) / 2
    assert row[0].get_ylabel().endswith(f"\nMAE {mae_cm:.2f} cm\nmIoU {miou:.3f}")


def test_names_from_a_dataset_are_drawn_as_they_are_and_cut_where_they_are_long():
    figure = scenes_figure([shown(object_class=r"$\frac{1}$" + 40 * "x")], "components")
    figure.canvas.draw()  # raises if matplotlib reads a formula
    assert r"\$\frac{1}\$xxxxxxx…" in panels(figure)[0][0].get_ylabel()


def test_scenes_are_spread_by_accuracy_from_the_best_to_the_worst_or_as_they_are_named():
    ranked = [SimpleNamespace(scene=f"{place:06}") for place in (4, 0, 8, 2, 6, 1, 7, 3, 5)]
    spread = choose_for_figures(ranked, ())
    assert [scene.scene for scene in spread.values()] == ["000004", "000008", "000006", "000007", "000005"]
    assert list(spread) == [f"rank {place} of 9" for place in (1, 3, 5, 7, 9)]
    named = choose_for_figures(ranked, ("000005", "000004", "000005"))
    assert {rank: scene.scene for rank, scene in named.items()} == {
        "rank 9 of 9": "000005",
        "rank 1 of 9": "000004",
    }
    assert list(named) == ["rank 9 of 9", "rank 1 of 9"]
    for count in (1, 2, 4, 5, 6):
        few = choose_for_figures(ranked[:count], ())
        assert len(few) == min(count, 5)  # no scene twice
        assert next(iter(few.values())) is ranked[0]
        assert list(few.values())[-1] is ranked[count - 1]


def test_scenes_that_cannot_be_shown_are_refused_in_a_sentence(finished_run, closed_form_scenes, tmp_path):
    out = tmp_path / "report"

    def judge(*scenes):
        evaluate(finished_run, closed_form_scenes, out, device="cpu", progress=False, scenes=scenes)

    (train, *_), tests = closed_form_scenes.ids("train"), closed_form_scenes.ids("test")
    with pytest.raises(DatasetError, match="has no scene 999999: its ids run from 000000 to 000011"):
        judge(tests[0], "999999")
    with pytest.raises(EvaluationError, match=f"scene {train} is a train scene, .* the test split: choose"):
        judge(train)
    assert not out.exists()
    words = ("night-eval", finished_run, closed_form_scenes.root, "--out", out, "--scene", "../x")
    assert "has no scene ../x" in refusal(*words)


def test_more_scenes_than_a_figure_shows_and_scenes_without_a_render_are_refused(finished_run, tmp_path):
    tables = {"count": MOST_FIGURE_SCENES + 3, "test_fraction": 0.95, "validation_fraction": 0.0}
    dataset = write_synthetic_dataset(tmp_path / "data", count=MOST_FIGURE_SCENES + 3, dataset=tables)
    many = dataset.ids("test")[: MOST_FIGURE_SCENES + 1]
    assert len(many) > MOST_FIGURE_SCENES
    with pytest.raises(EvaluationError, match="at most 20 scenes, and 21 are named"):
        evaluate(finished_run, dataset, tmp_path / "report", device="cpu", progress=False, scenes=many)
    record = FailureRecord(recipe="", attempts=2, reason="broken")
    write_failure(dataset.render_folder(many[0]), record, "")
    with pytest.raises(EvaluationError, match=f"scene {many[0]} of .* could not be rendered"):
        evaluate(finished_run, dataset, tmp_path / "report", device="cpu", progress=False, scenes=many[:2])
    assert not (tmp_path / "report").exists()


@pytest.mark.long
def test_the_report_shows_the_scenes_that_are_named_and_they_change_no_number(
    finished_run, closed_form_scenes, tmp_path, monkeypatch
):
    seen = []

    def draw(scenes, target):
        if len(scenes) > 1:  # the others are best, median and worst
            seen.append([scene.result.scene for scene in scenes])
        return scenes_figure(scenes, target)

    monkeypatch.setattr("model.judging.report.report_scenes.scenes_figure", draw)
    wanted = closed_form_scenes.ids("train")[3:1:-1]
    options = {"split": "train", "device": "cpu", "progress": False}
    plain = evaluate(finished_run, closed_form_scenes, tmp_path / "plain", **options)
    chosen = evaluate(finished_run, closed_form_scenes, tmp_path / "chosen", scenes=wanted, **options)
    assert seen[1] == wanted
    assert seen[0] == [result.scene for result in choose_for_figures(plain.ranked, ()).values()]
    assert plain == chosen
    pictures = [(tmp_path / name / "figures" / "scenes.png").read_bytes() for name in ("plain", "chosen")]
    assert pictures[0] != pictures[1]
