"""The report's page: one HTML file that loads nothing from the network.

The page's words and structure are in ``data/report/page.html.jinja``; this module prepares its data.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from disk import data_folder, write_text
from itof.pictures.figures import write_figure, write_pdf
from model.judging.calibration import Calibration
from model.judging.report.chart_png import chart_figure
from model.judging.report.charts import (
    calibration_curves,
    depth_error_charts,
    distributions,
    roundness_chart,
    sequence_charts,
    training_curves,
    uncertainty_charts,
)
from model.judging.report.report_scenes import (
    cloud_colours,
    clouds_picture,
    every_scene,
    film_picture,
    point_clouds,
    scenes_picture,
)
from model.judging.report_files import GROUP_HEAD, SUMMARY_HEAD, group_texts, summary_rows
from model.judging.results import PAPER, Report
from model.judging.scene_sheet import SceneSheet
from model.judging.showcase import ShownScene
from model.run_folder.run_config import RunConfig

TEMPLATE = "page.html.jinja"
PACKAGES = ("night-nlos", "torch", "numpy", "plotly")
TILES = (  # field of Summary, name, scale, format
    ("depth_mae_m", "MAE over all pixels", 100.0, "{:.2f} cm"),
    ("miou", "mIoU", 1.0, "{:.3f}"),
    ("accuracy", "accuracy", 1.0, "{:.3f}"),
)


def write_page(
    out: Path,
    report: Report,
    sheet: SceneSheet,
    shown: Sequence[ShownScene],
    figured: Sequence[ShownScene],
    history: Mapping[str, Sequence[float]],
    config: RunConfig,
    origin: Mapping[str, Any],
) -> None:
    """Write ``index.html``, and its pictures and charts also as PNG and PDF into ``figures/``.

    The film of a sequence is in `out` already (`sequence_film`).

    Parameters
    ----------
    sheet : the pictures of all scenes.
    shown : the scenes to show one by one, as pictures and as point clouds.
    figured : the scenes to show in the figures of several scenes.
    history : columns of the run's ``history.csv``, as it was with the weights that were judged.
    origin : what was judged on what, as plain data.
    """
    figures, target = out / "figures", config.settings.target.kind
    figures.mkdir()
    charts = {
        "sequence": sequence_charts(report),
        "distributions": distributions(report),
        "roundness": (roundness_chart(report),),
        "uncertainty": (*uncertainty_charts(report), *depth_error_charts(report)),
        "thresholds": calibration_curves(report.calibration),
        "training": training_curves(history),
    }
    every_chart = [chart for group in charts.values() for chart in group]
    for chart in every_chart:
        figure = chart_figure(chart)
        write_figure(figures / f"{chart.name}.png", figure)
        write_pdf(figures / f"{chart.name}.pdf", figure)
    page = _environment().get_template(TEMPLATE)
    content = page.render(
        version=version("night-nlos"),
        run_name=Path(origin["run"]).name,
        dataset_name=Path(origin["dataset"]).name,
        image_size=origin["image_size"],
        split=report.split,
        scene_count=len(report.scenes),
        warnings=report.warnings,
        judged_with=report.calibration.judged_with,
        tiles=_tiles(report),
        summary_head=SUMMARY_HEAD,
        summary=summary_rows(report),
        paper=PAPER["source"],
        target=target,
        pictures=[scenes_picture([one], target, figures / f"{one.rank}.png") for one in shown],
        film=film_picture(out) if report.frame_rate_hz else None,
        frame_rate_hz=report.frame_rate_hz,
        scenes_picture=scenes_picture(figured, target, figures / "scenes.png"),
        every_scene=every_scene(report, sheet),
        clouds=point_clouds(shown),
        clouds_picture=clouds_picture(figured, figures),
        cloud_colours=cloud_colours(),
        charts=charts,
        chart_data={chart.name: chart.as_data() for chart in every_chart},
        group_head=GROUP_HEAD,
        groups=_groups(report),
        share_column=GROUP_HEAD.index("MAE, cm"),
        threshold=_threshold(report.calibration),
        depth_errors_m=report.depth_reliability.means_m if report.depth_reliability else None,
        compares_mask_and_depth=any(history.get("validation_uncertainty", ())),
        calibration_error=report.reliability.calibration_error if report.reliability else None,
        configuration=_configuration(config, origin, report),
    )
    write_text(out / "index.html", content + "\n")


def _environment() -> Environment:
    """Templates of the report; all text is escaped but for our own styles and scripts, and plotly's."""
    folder = data_folder("report")

    def trusted(name: str) -> Markup:
        return Markup((folder / name).read_text(encoding="utf-8"))  # noqa: S704 -- a file of ours

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        loader=FileSystemLoader(folder),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # JSON inside <script>: jinja's filter tojson writes < as \u003c; NaN would not be JSON.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False}
    environment.filters["value_text"] = _value_text
    environment.globals["trusted"] = trusted
    plotly = get_plotlyjs().replace("</script", "<\\/script")
    environment.globals["plotly"] = Markup(plotly)  # noqa: S704 -- plotly's own source
    return environment


def _tiles(report: Report) -> list[dict[str, str]]:
    """The numbers that a reader sees first; `paper` is "" where the paper gives none."""
    tiles = []
    for field, name, scale, form in TILES:
        ours, nothing = (getattr(summary, field).mean for summary in (report.prediction, report.no_object))
        paper = PAPER.get(field)
        tiles.append(
            {
                "name": name,
                "prediction": form.format(scale * ours),
                "no_object": form.format(scale * nothing),
                "paper": form.format(scale * paper["mean"]) if isinstance(paper, dict) else "",
            }
        )
    return tiles


def _groups(report: Report) -> list[dict[str, Any]]:
    """The tables by group; a row's `share` is its MAE as a part of that of "no object", at most 1."""
    return [
        {
            "title": table.title,
            "explanation": table.explanation,
            "rows": [
                {
                    "name": group.name,
                    "texts": group_texts(group),
                    "share": min(group.depth_mae_m / group.no_object_mae_m, 1.0)
                    if group.no_object_mae_m > 0
                    else None,
                }
                for group in table.groups
            ],
        }
        for table in report.groups
    ]


def _threshold(calibration: Calibration) -> dict[str, Any]:
    """Scores at the run's own threshold, and at the one that is best on validation, where there is one.

    ``own`` is None if the masks of the run are those of the depth.
    """
    best = calibration.best_on_validation
    return {
        "has_amplitude": calibration.has_amplitude,
        "own": calibration.judged.at(calibration.run_threshold)
        if calibration.run_readout.mask_from == "amplitude"
        else None,
        "best": best,
        "judged_at_best": calibration.judged.at(best.threshold) if best else None,
    }


def _configuration(config: RunConfig, origin: Mapping[str, Any], report: Report) -> dict[str, Any]:
    """Tables of the run's settings and inputs, the data, and the programs: names and values by title."""
    content = asdict(config)
    tables = {name: value for name, value in content.items() if isinstance(value, dict)}
    run = {name: value for name, value in content.items() if name not in tables}
    judged = {
        **origin,
        "trained_on_these_data": config.data_sha256 == origin["data_sha256"]
        if config.settings.run.ground_truth == "geometry"
        else "not compared: the ground truth of the training was the simulated one",
        "split": report.split,
        "mask_from": report.calibration.judged_readout.mask_from,
        "mask_threshold": report.calibration.judged_threshold,
    }
    versions = {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
    parts = {"judged": judged, "versions of this evaluation": versions, "run": run, **tables}
    parts["settings"] = parts.pop("settings")  # the longest takes a column of its own
    return parts


def _value_text(value: Any) -> str:
    """A setting's value as people read it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{name.replace('_', ' ')}: {_value_text(part)}" for name, part in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_value_text(part) for part in value) or "none"
    return "not set" if value is None else str(value)
