"""The report's files for programs and for documents: JSON, CSV, text, Markdown and LaTeX."""

from __future__ import annotations

import csv
import html
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from disk import whole_file, write_text
from disk.counted import counted
from disk.own_files import hashes_of
from disk.plain_file import MOST_LIST_BYTES, read_plain
from itof.metrics import Statistics
from model.judging.calibration import Calibration
from model.judging.groups import Group, GroupTable
from model.judging.latex_tables import REFERENCES, caption_of, latex_table
from model.judging.results import PAPER, Report, scene_numbers

REPORT_SCHEMA = 1
METRICS_FILE = "metrics.json"
SUMMARY_HEAD = ("measure", "", "average", "std", "min", "max")
GROUP_HEAD = ("scenes", "MAE, cm", "object MAE, cm", "mIoU", "no object: MAE, cm")
IN_SUMMARY = ("object_class", "roughness")  # the group tables that documents want


def files_of_report(folder: Path) -> dict[str, str | None]:
    """Files of an earlier report by path, with SHA-256 where it is known; empty if there is no report.

    A path that ends in a slash is that of a folder, which may be empty.
    """
    try:
        content = json.loads(read_plain(folder / METRICS_FILE, MOST_LIST_BYTES))
        if content["schema_version"] != REPORT_SCHEMA:
            return {}
        known = {str(name): str(sha256) for name, sha256 in content["files"].items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}
    return {**known, METRICS_FILE: None, "pointclouds/": None}


def write_files(out: Path, report: Report, origin: Mapping[str, Any]) -> None:
    """Write the numbers and tables of a report, and at last ``metrics.json``.

    ``metrics.json`` lists all files in the folder `out` with their hashes, by which the next evaluation knows
    that the folder holds nothing else.

    Parameters
    ----------
    origin : what was judged on what, as plain data.
    """
    scenes = [scene_numbers(result) for result in report.scenes]
    content: dict[str, Any] = {
        "schema_version": REPORT_SCHEMA,
        **origin,
        "split": report.split,
        "scene_count": len(report.scenes),
        "frame_rate_hz": report.frame_rate_hz,
        "warnings": report.warnings,
        "depth": "radial (along the ray), metres; background counts with depth 0",
        "mask_from": report.calibration.judged_readout.mask_from,
        "run_mask_from": report.calibration.run_readout.mask_from,
        "mask_threshold": report.calibration.judged_threshold,
        "run_mask_threshold": report.calibration.run_threshold,
        "prediction": asdict(report.prediction),
        "no_object": asdict(report.no_object),
        "object_distance_m": _plain(report.object_distance_m),
        "relative_mae": {who: _plain(each) for who, each in report.relative_mae.items()},
        "expected_mae_m": _plain(report.expected_mae_m),
        "explained_light": _plain(report.explained_light),
        "reliability": report.reliability.as_data() if report.reliability else None,
        "depth_reliability": report.depth_reliability.as_data() if report.depth_reliability else None,
        "roundness": {who: _plain(each) for who, each in report.roundness.items()},
        "accuracy_histogram": asdict(report.accuracy_histogram),
        "paper": PAPER,
        "groups": {table.key: [asdict(group) for group in table.groups] for table in report.groups},
        "calibration": _calibration(report.calibration),
        "scenes": scenes,
    }
    write_text(out / "table.txt", report.table + "\n")
    write_text(out / "summary.md", summary_markdown(report))
    write_text(out / "tables.tex", tables_latex(report))
    write_text(out / "references.bib", REFERENCES)
    with (
        whole_file(out / "metrics.csv") as partial,
        partial.open("w", encoding="utf-8", newline="", errors="backslashreplace") as stream,
    ):
        table = csv.DictWriter(stream, fieldnames=list(scenes[0]))
        table.writeheader()
        table.writerows(scenes)
    content["files"] = hashes_of(out)
    write_text(out / METRICS_FILE, json.dumps(content, indent=2, allow_nan=False) + "\n")


def summary_markdown(report: Report) -> str:
    """The summary, and the tables by shape and by roughness, to be pasted into a document."""
    count = counted(len(report.scenes), "scene")
    head = f"{report.split} split, {count}, radial depth; {report.calibration.judged_with}."
    lines = [head, "", *(f"**Warning: {html.escape(each, quote=False)}.**\n" for each in report.warnings)]
    lines += _markdown(SUMMARY_HEAD, summary_rows(report), words=2)
    for table in report.groups:
        if table.key in IN_SUMMARY:
            lines += ["", *_markdown((table.title, *GROUP_HEAD), _group_rows(table), words=1)]
    return "\n".join(lines) + "\n"


def tables_latex(report: Report) -> str:
    """The summary and all tables of groups, to be included in a paper."""
    tables = [latex_table(caption_of(report, "Accuracy"), SUMMARY_HEAD, summary_rows(report), words=2)]
    for table in report.groups:
        caption, head = caption_of(report, f"Accuracy by {table.title}"), (table.title, *GROUP_HEAD)
        tables.append(latex_table(caption, head, _group_rows(table), words=1))
    return "\n\n".join((r"% needs \usepackage{booktabs}", *tables)) + "\n"


def _group_rows(table: GroupTable) -> list[tuple[str, ...]]:
    return [(group.name, *group_texts(group)) for group in table.groups]


def summary_rows(report: Report) -> list[tuple[str, ...]]:
    """Rows of the summary in the order of SUMMARY_HEAD: measure, whose, and the statistics as text."""
    return [(measure.name, who, *texts) for measure, who, texts in report.lines()]


def group_texts(group: Group) -> tuple[str, ...]:
    """Numbers of a group in the order of GROUP_HEAD."""
    on_object = "-" if group.object_mae_m is None else f"{100 * group.object_mae_m:.2f}"
    return (
        f"{group.count}",
        f"{100 * group.depth_mae_m:.2f}",
        on_object,
        f"{group.miou:.3f}",
        f"{100 * group.no_object_mae_m:.2f}",
    )


def _plain(statistics: Statistics | None) -> dict[str, Any] | None:
    return None if statistics is None else asdict(statistics)


def _calibration(calibration: Calibration) -> dict[str, Any]:
    """The sweep as plain data, and what validation recommends."""
    content: dict[str, Any] = {
        curve.split: [asdict(point) for point in curve.points]
        for curve in (calibration.validation, calibration.judged)
        if curve is not None
    }
    best = calibration.best_on_validation
    if best is not None:
        content["best_on_validation"] = asdict(best)
        content["judged_split_at_that_threshold"] = asdict(calibration.judged.at(best.threshold))
    return content


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]], *, words: int) -> list[str]:
    """A Markdown table; the first `words` columns are words, the others numbers and stand right."""
    rule = ["---" if column < words else "---:" for column in range(len(head))]
    return ["| " + " | ".join(_cell(text) for text in row) + " |" for row in (head, rule, *rows)]


def _cell(text: str) -> str:
    return html.escape(text, quote=False).replace("|", "\\|").replace("\n", " ")
