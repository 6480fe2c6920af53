"""Validation error of runs over the samples that they have seen, as a table and a picture.

With --law-from, a power law through the epochs from that number of samples on says what the run would have
after as many samples as the paper's training saw, and the same law through their second half says how far to
trust it. Epochs are averaged in windows, because single ones scatter. Run:

    .venv/bin/python benchmarks/training_curves.py paper40 paper80 both80 --scenes 860 --out curves.png \
        --law-from 200000
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from itof.pictures.figures import write_figure
from model.run_folder.history import read_history

PAPER_SAMPLES = 695 * 2833  # epochs times samples, sec. 4.2
PAPER = {"validation_mae_cm": 5.21, "validation_miou": 0.77}  # on its test scenes
WORDS = {"validation_mae_cm": "MAE, cm", "validation_miou": "mIoU"}
WINDOW = 10  # epochs
Curve = tuple[NDArray[np.float64], NDArray[np.float64]]


def main() -> None:
    """Print the table, draw the curves, and extrapolate where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="run folders")
    parser.add_argument("--scenes", type=int, required=True, help="samples of an epoch")
    parser.add_argument("--out", type=Path, required=True, help="picture to write")
    parser.add_argument("--rows", type=int, default=8, help="rows of the table for each run, default 8")
    parser.add_argument("--law-from", type=int, help="samples from which on a power law is fitted")
    given = parser.parse_args()
    histories = {run.name: read_history(run) for run in given.runs}
    print("| run | samples | of the paper's | MAE cm | mIoU |\n|---|---|---|---|---|")
    for name, history in histories.items():
        samples, mae_cm = windows(history["validation_mae_cm"], given.scenes)
        miou = windows(history["validation_miou"], given.scenes)[1]
        for place in np.unique(np.geomspace(1, len(samples), given.rows).round().astype(int)) - 1:
            seen = samples[place]
            share = f"{100 * seen / PAPER_SAMPLES:.1f} %"
            print(f"| {name} | {seen:,.0f} | {share} | {mae_cm[place]:.2f} | {miou[place]:.3f} |")
    if given.law_from:
        for name, history in histories.items():
            curve = windows(history["validation_mae_cm"], given.scenes)
            print(f"{name}: {extrapolated(curve, given.law_from)}")
    write_figure(given.out, drawn(histories, given.scenes))


def windows(values: list[float], scenes: int) -> Curve:
    """Samples at the middle of windows of epochs, and the mean of the values in each."""
    parts = [values[start : start + WINDOW] for start in range(0, len(values), WINDOW)]
    parts = [part for part in parts if len(part) == WINDOW] or [values]
    middles = scenes * (WINDOW * np.arange(len(parts)) + (len(parts[0]) + 1) / 2)
    return middles, np.array([np.mean(part) for part in parts])


def extrapolated(curve: Curve, law_from: int) -> str:
    """What the power law gives for the paper's number of samples, by all and by half of the windows."""
    samples, mae_cm = (values[curve[0] >= law_from] for values in curve)
    if len(samples) < 4:
        return f"too few epochs after {law_from} samples for a law"
    half = len(samples) // 2
    results = []
    for first in (0, half):
        slope, start = np.polyfit(np.log(samples[first:]), np.log(mae_cm[first:]), 1)
        results.append(f"{np.exp(start + slope * np.log(PAPER_SAMPLES)):.1f} cm (samples^{slope:.2f})")
    return f"MAE after {PAPER_SAMPLES:,} samples by a power law {results[0]}, by its second half {results[1]}"


def drawn(histories: dict[str, dict[str, list[float]]], scenes: int) -> Figure:
    """MAE and mIoU over samples; the dashed line is the paper's result on its test scenes."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (column, words) in zip(figure.subplots(1, 2), WORDS.items(), strict=True):
        for name, history in histories.items():
            axes.plot(scenes * np.array(history["epoch"]), history[column], lw=0.8, label=name)
        axes.axhline(PAPER[column], color="black", ls="--", lw=0.8, label="paper, its own data")
        axes.axvline(PAPER_SAMPLES, color="grey", ls=":", lw=0.8, label="samples of the paper's training")
        axes.set(xscale="log", xlabel="training samples", ylabel=f"validation {words}")
    figure.axes[0].set_ylim(0, 30)
    figure.axes[0].legend(fontsize=8)
    return figure


if __name__ == "__main__":
    main()
