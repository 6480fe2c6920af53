"""Results of a network behind a modelled camera: one row for each exposure or imperfection, and a picture."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from disk import whole_file, write_text
from disk.own_files import hashes_of
from disk.plain_file import MOST_LIST_BYTES, read_plain
from itof.metrics import NUMBERS, Statistics, Summary, summary_cells
from itof.pictures.figures import write_figure
from itof.sensor.settings import SensorSettings

EXPOSURE_SCHEMA = 1
RESULT_FILE, TABLE_FILE, FIGURE_FILE = "exposures.json", "exposures.csv", "exposures.png"
_BLUE, _ORANGE, _GREY = "#0b6fb8", "#d9730d", "#5f6770"


@dataclass(frozen=True)
class ExposureRow:
    """One camera and its results.

    Attributes
    ----------
    name : of the camera: ``all`` of its imperfections, ``none``, or which of them.
    frames : averaged measurements.
    light_s : integration time of all raw frames together, seconds.
    electrons : of the emitter's light in both taps of a sensor pixel, in all raw frames; median of pixels.
    phase_noise_rad : of an image pixel at the last frequency, by the closed form for `electrons`.
    snr_pixel, snr_image : bound of the hidden light's signal to noise (`hidden_snr`), mean over
        the scenes; None without noise.
    saturated : part of the sensor pixels and raw frames that are saturated.
    metrics : of the network's depth maps.
    """

    name: str
    frames: int
    light_s: float
    electrons: float
    phase_noise_rad: float | None
    snr_pixel: float | None
    snr_image: float | None
    saturated: float
    metrics: Summary


@dataclass(frozen=True)
class ExposureReport:
    """Results of all cameras.

    Attributes
    ----------
    sensor : settings of the camera.
    corner_frames : averaged measurements of the empty corner; 0 if the network had no capture of it.
    rows : of the cameras; perfect : of phasors as rendered; no_object : of predicting no object.
    """

    sensor: SensorSettings
    corner_frames: int
    rows: tuple[ExposureRow, ...]
    perfect: Summary
    no_object: Summary

    @property
    def table(self) -> str:
        """The results as a Markdown table; ± are standard errors over the scenes."""
        head = (
            *(
                "camera",
                "exposures",
                "light, ms",
                "electrons",
                "noise of a pixel, mrad",
                "hidden light / noise",
            ),
            *("saturated %", *NUMBERS),
        )
        lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
        for row in self.rows:
            noise, snr = (
                "-" if each is None else f"{factor * each:.2g}"
                for each, factor in ((row.phase_noise_rad, 1e3), (row.snr_pixel, 1))
            )
            cells = (
                *(
                    row.name,
                    f"{row.frames // self.sensor.frames}",
                    f"{1e3 * row.light_s:.3g}",
                    f"{row.electrons:.3g}",
                ),
                *(noise, snr, f"{100 * row.saturated:.1f}"),
            )
            lines.append(f"| {' | '.join((*cells, *summary_cells(row.metrics)))} |")
        for name, summary in (
            ("phasors as rendered", self.perfect),
            ("predicting no object", self.no_object),
        ):
            lines.append(f"| {name} |{' |' * 6} {' | '.join(summary_cells(summary))} |")
        return "\n".join(lines)

    def write(self, out: Path, origin: dict[str, Any]) -> None:
        """Write ``exposures.csv``, and at last ``exposures.json`` with the hashes of all files.

        Parameters
        ----------
        origin : what was judged on what, as plain data.
        """
        with (
            whole_file(out / TABLE_FILE) as partial,
            partial.open("w", encoding="utf-8", newline="", errors="backslashreplace") as stream,
        ):
            rows = [_flat(row) for row in self.rows]
            table = csv.DictWriter(stream, fieldnames=list(rows[0]))
            table.writeheader()
            table.writerows(rows)
        content = {"schema_version": EXPOSURE_SCHEMA, **origin, **asdict(self), "files": hashes_of(out)}
        write_text(out / RESULT_FILE, json.dumps(content, indent=2, allow_nan=False) + "\n")


def files_of_exposures(folder: Path) -> dict[str, str | None]:
    """Files of earlier results by path, with SHA-256; empty if there are none."""
    try:
        content = json.loads(read_plain(folder / RESULT_FILE, MOST_LIST_BYTES))
        if content["schema_version"] != EXPOSURE_SCHEMA:
            return {}
        known = {str(name): str(sha256) for name, sha256 in content["files"].items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}
    return {**known, RESULT_FILE: None}


def _flat(row: ExposureRow) -> dict[str, Any]:
    numbers = {key: value for key, value in asdict(row).items() if key != "metrics"}
    for name in ("depth_mae_m", "miou", "object_mae_m"):
        found = getattr(row.metrics, name)
        numbers[name] = None if found is None else found.mean
        numbers[f"{name}_error"] = None if found is None else found.standard_error
    return numbers


def write_exposure_figure(file: Path, report: ExposureReport) -> None:
    """Write a PNG with three charts: MAE, mIoU, and hidden light over noise (Cramer-Rao bound)."""
    rows = report.rows
    light_ms = [1e3 * row.light_s for row in rows]
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    error, overlap, noise = figure.subplots(1, 3)
    for axes, values, deviation, perfect, nothing, title in (
        (
            error,
            [100 * row.metrics.depth_mae_m.mean for row in rows],
            [100 * _bar(row.metrics.depth_mae_m) for row in rows],
            *(100 * each.depth_mae_m.mean for each in (report.perfect, report.no_object)),
            "MAE, cm",
        ),
        (
            overlap,
            [row.metrics.miou.mean for row in rows],
            [_bar(row.metrics.miou) for row in rows],
            *(each.miou.mean for each in (report.perfect, report.no_object)),
            "mIoU",
        ),
    ):
        axes.errorbar(light_ms, values, deviation, color=_BLUE, marker="o", markersize=4, label="camera")
        axes.axhline(perfect, color=_ORANGE, linestyle="--", linewidth=1.2, label="phasors as rendered")
        axes.axhline(nothing, color=_GREY, linestyle=":", linewidth=1.2, label="no object")
        axes.set_ylabel(title)
        axes.legend(fontsize=8, frameon=False)
    error.set_ylim(bottom=0)
    bounds = [row.snr_pixel for row in rows]
    if all(bound is not None for bound in bounds):
        noise.plot(light_ms, bounds, color=_BLUE, marker="o", markersize=4)
        noise.set_yscale("log")
    noise.axhline(1, color=_GREY, linestyle=":", linewidth=1.2)
    noise.set_ylabel("hidden light / noise of a pixel")
    for axes in (error, overlap, noise):
        axes.set_xscale("log")
        axes.set_xlabel("light of all raw frames, ms")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#dde1e6", linewidth=0.6)
    write_figure(file, figure)


def _bar(found: Statistics) -> float:
    """Length of an error bar; NaN, which is not drawn, if one scene does not tell it."""
    return math.nan if found.standard_error is None else found.standard_error
