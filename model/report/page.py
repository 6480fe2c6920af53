"""The report as a page that one looks at: everything in one HTML file, nothing from the network."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

from matplotlib.figure import Figure
from plotly.offline import get_plotlyjs

from model.prediction.figures import write_figure
from model.report.calibration import Calibration
from model.report.charts import calibration_curves, distributions, inline_svg, training_curves
from model.report.report_files import GROUP_HEAD, group_texts
from model.report.report_html import Section, grid, note, settings, table, tile
from model.report.report_scenes import cloud_data, pictures, point_clouds
from model.report.results import PAPER, Report
from model.report.showcase import Cloud, ShownScene, cloud_of
from model.run_folder import RunConfig, read_history
from scenegen import data_folder, write_text

# The browser itself refuses whatever is not in the file: nothing of plotly could load, were it ever to try.
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:; "
    "worker-src blob:; base-uri 'none'; form-action 'none'"
)
PACKAGES = ("night-nlos", "torch", "numpy", "plotly")


def write_page(
    out: Path,
    report: Report,
    shown: Sequence[ShownScene],
    run: Path,
    config: RunConfig,
    origin: Mapping[str, Any],
) -> None:
    """Write ``index.html``, and its pictures also as PNG into ``figures/``.

    Parameters
    ----------
    shown : the scenes to show as pictures and as point clouds.
    origin : what was judged on what, as plain data.
    """
    figures = out / "figures"
    figures.mkdir()
    clouds = [cloud_of(scene) for scene in shown]
    sections = [
        _summary(report),
        pictures(report, shown, figures),
        point_clouds(shown, clouds),
        _distributions(report, figures),
        _groups(report),
        _threshold(report, figures),
        _training(run, figures),
        _configuration(config, origin, report),
    ]
    write_text(out / "index.html", _fill(report, origin, sections, clouds))


def _fill(
    report: Report, origin: Mapping[str, Any], sections: Sequence[Section], clouds: Sequence[Cloud | None]
) -> str:
    """The template with everything in its place."""
    parts = {name: _template(name) for name in ("page.html", "page.css", "errors.js", "clouds.js")}
    heading = f"Run {Path(origin['run']).name} on dataset {Path(origin['dataset']).name}"
    width, height = origin["image_size"]
    return Template(parts["page.html"]).substitute(
        policy=escape(POLICY),
        title=escape(f"NIGHT: {heading}"),
        heading=escape(heading),
        lede=escape(
            f"{len(report.scenes)} scenes of the {report.split} split, {width} x {height} pixels, "
            f"{report.calibration.judged_with}. Depth is radial (along the ray of a pixel); background "
            "counts as depth 0."
        ),
        style=parts["page.css"],
        links=" ".join(section.link for section in sections),
        sections="\n".join(section.html for section in sections),
        version=escape(version("night-nlos")),
        errors=parts["errors.js"],
        plotly=get_plotlyjs().replace("</script", "<\\/script"),
        clouds=json.dumps([cloud_data(cloud) for cloud in clouds]).replace("<", "\\u003c"),
        script=parts["clouds.js"],
    )


def _summary(report: Report) -> Section:
    tiles = []
    for field, name, scale, form in (
        ("depth_mae_m", "MAE over all pixels", 100.0, "{:.2f} cm"),
        ("miou", "mIoU", 1.0, "{:.3f}"),
        ("accuracy", "accuracy", 1.0, "{:.3f}"),
    ):
        ours, nothing = (
            form.format(scale * getattr(s, field).mean) for s in (report.prediction, report.no_object)
        )
        paper = PAPER.get(field)
        beside = f", paper {form.format(scale * paper['mean'])}" if isinstance(paper, dict) else ""
        tiles.append(tile(name, ours, f"no object {nothing}{beside}"))
    rows = [(measure.name, who, *texts) for measure, who, texts in report.lines()]
    return Section(
        "summary",
        "Summary",
        "A prediction is worth something as far as it beats predicting “no object” everywhere. MAE: smaller "
        "is better; the others: 1 is perfect. Accuracy is the mean of (1 - MAE in metres) and mIoU.",
        f'<div class="tiles">{"".join(tiles)}</div>'
        + table(("measure", "", "average", "std", "min", "max"), rows, words=2)
        + note(f"Paper: {PAPER['source']}."),
    )


def _distributions(report: Report, figures: Path) -> Section:
    return Section(
        "distributions",
        "Distributions",
        "How many scenes have which value; the averages are dashed. Where the two heaps overlap, the "
        "network does no better than seeing nothing.",
        _charts(distributions(report), figures),
    )


def _groups(report: Report) -> Section:
    parts = []
    for group_table in report.groups:
        rows = [(group.name, *group_texts(group)) for group in group_table.groups]
        shares = {
            place: group.depth_mae_m / group.no_object_mae_m
            for place, group in enumerate(group_table.groups)
            if group.no_object_mae_m > 0
        }
        parts.append(
            f"<h3>{escape(group_table.title)}</h3>{note(group_table.note)}"
            + table(("", *GROUP_HEAD), rows, shares=shares, share_column=2)
        )
    return Section(
        "groups",
        "By shape, wall, position and size",
        "Averages over the scenes of a group. The bar behind the MAE is its share of the MAE of “no object”: "
        "a full bar means that nothing was gained. Object MAE counts pixels that truth and prediction share.",
        grid(parts, "flow"),
    )


def _threshold(report: Report, figures: Path) -> Section:
    calibration = report.calibration
    return Section(
        "threshold",
        "Threshold of the mask",
        "A pixel shows the object where the predicted amplitude reaches a threshold. The curves say what "
        "other thresholds would give; it has to be chosen on validation scenes, never on those judged.",
        note(_advice(calibration)) + _charts(calibration_curves(calibration), figures),
    )


def _advice(calibration: Calibration) -> str:
    """What the sweep says, in words."""
    own = calibration.judged.at(calibration.run_threshold)
    judged = calibration.judged.split
    of_own = (
        f"The run's own threshold, {own.threshold:g}, gives mIoU {own.miou:.3f} and "
        f"MAE {100 * own.depth_mae_m:.2f} cm on the {judged} split."
    )
    if calibration.validation is None:
        return f"{of_own} The dataset has no validation scenes, so no other can be recommended."
    best = calibration.validation.best
    there = calibration.judged.at(best.threshold)
    if calibration.judged.split == "validation":
        return f"{of_own} The best there (by mIoU) is {_scores(best.threshold, best.miou, best.depth_mae_m)}."
    return (
        f"{of_own} Best on validation (by mIoU) is "
        f"{_scores(best.threshold, best.miou, best.depth_mae_m)}; on the {judged} split that threshold gives "
        f"mIoU {there.miou:.3f} and MAE {100 * there.depth_mae_m:.2f} cm."
    )


def _scores(threshold: float, miou: float, depth_mae_m: float) -> str:
    return f"{threshold:g} (mIoU {miou:.3f}, MAE {100 * depth_mae_m:.2f} cm)"


def _training(run: Path, figures: Path) -> Section:
    charts = training_curves(read_history(run))
    return Section(
        "training",
        "Training",
        "The run by epoch. The weights judged here are those of the lowest validation loss; a training loss "
        "that falls while the other rises is overfitting.",
        _charts(charts, figures)
        if charts
        else note("The run folder has no history.csv: there is nothing to draw."),
    )


def _configuration(config: RunConfig, origin: Mapping[str, Any], report: Report) -> Section:
    """The run's settings and inputs, the data, and the programs."""
    content = asdict(config)
    tables = {name: value for name, value in content.items() if isinstance(value, dict)}
    run = {name: value for name, value in content.items() if name not in tables}
    calibration = report.calibration
    judged = {
        **origin,
        "trained_on_these_data": config.data_sha256 == origin["data_sha256"],
        "split": report.split,
        "mask_threshold": calibration.judged_threshold,
    }
    versions = {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
    parts = {"judged": judged, "versions of this evaluation": versions, "run": run, **tables}
    parts["settings"] = parts.pop("settings")  # the longest takes a column of its own
    return Section(
        "configuration",
        "Configuration",
        "All that decides the numbers above: what was judged, and how the network was trained.",
        grid(
            (f"<h3>{escape(name.capitalize())}</h3>{settings(values)}" for name, values in parts.items()),
            "flow",
        ),
    )


def _charts(charts: Mapping[str, Figure], figures: Path) -> str:
    """Charts beside one another; each is written as a PNG too."""
    for name, figure in charts.items():
        write_figure(figures / f"{name}.png", figure)
    return grid((inline_svg(name, figure) for name, figure in charts.items()), "three")


def _template(name: str) -> str:
    return (data_folder("report") / name).read_text(encoding="utf-8")
