"""Table 1 of the paper, over several seeds: what the reports of night-eval on the same scenes have in common.

Average, standard deviation, minimum and maximum are over the test scenes, as in the paper; each is the mean
over the reports, with its standard deviation over them. The histogram has the paper's bins. Run:

    for seed in 0 1 2; do night-eval table2/base-$seed mydata --out report-$seed; done
    .venv/bin/python benchmarks/table_one.py report-0 report-1 report-2
"""

import argparse
import json
from itertools import pairwise
from pathlib import Path
from statistics import mean, stdev
from typing import Any

ROWS = (("depth_mae_m", "MAE, cm", 100, 2), ("miou", "mIoU", 1, 3), ("accuracy", "accuracy", 1, 3))
COLUMNS = ("mean", "std", "min", "max")


def main() -> None:
    """Print the table and the histogram as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reports", type=Path, nargs="+", help="folders that night-eval wrote")
    reports = [json.loads((each / "metrics.json").read_text()) for each in parser.parse_args().reports]
    width, height = reports[0]["image_size"]
    print(f"{len(reports)} reports on {reports[0]['scene_count']} scenes of {width} x {height} pixels\n")
    print("| | average | std | min | max |\n|---|---|---|---|---|")
    for name, words, factor, digits in ROWS:
        cells = [spread([factor * r["prediction"][name][c] for r in reports], digits) for c in COLUMNS]
        print(f"| {words} | {' | '.join(cells)} |")
        if name in reports[0]["paper"]:
            paper = [f"{factor * reports[0]['paper'][name][c]:.{digits}f}" for c in COLUMNS]
            print(f"| {words}, paper | {' | '.join(paper)} |")
    distance = spread([100 * r["relative_mae"]["prediction"]["mean"] for r in reports], 2)
    print(f"\nMAE over the object's distance: {distance} % (paper: 1 to 2 %)\n")
    print_histogram([r["accuracy_histogram"] for r in reports])


def print_histogram(histograms: list[dict[str, Any]]) -> None:
    """Shares of the scenes in the paper's bins of accuracy, in percent."""
    edges, paper = histograms[0]["edges"], histograms[0]["paper_counts"]
    totals = [sum(h["counts"]) + h["below"] + h["above"] for h in histograms]
    print("| accuracy | scenes, % | paper, % |\n|---|---|---|")
    rows = [(f"below {edges[0]:.3f}", [h["below"] for h in histograms], 0.0)]
    for index, (low, high) in enumerate(pairwise(edges)):
        share = 100 * paper[index] / sum(paper)
        rows.append((f"{low:.3f} to {high:.3f}", [h["counts"][index] for h in histograms], share))
    rows.append((f"above {edges[-1]:.3f}", [h["above"] for h in histograms], 0.0))
    for words, counts, share in rows:
        shares = [100 * count / total for count, total in zip(counts, totals, strict=True)]
        print(f"| {words} | {mean(shares):.1f} | {share:.1f} |")


def spread(values: list[float], digits: int) -> str:
    """The mean and, of several values, their standard deviation."""
    text = f"{mean(values):.{digits}f}"
    return f"{text} ± {stdev(values):.{digits}f}" if len(values) > 1 else text


if __name__ == "__main__":
    main()
