"""The three numbers by which depth maps are compared, as cells of a table."""

from __future__ import annotations

from model.network.metrics import Summary

NUMBERS = ("MAE cm", "mIoU", "object MAE cm")


def summary_cells(summary: Summary) -> tuple[str, str, str]:
    """MAE, mIoU and object MAE with their standard errors; ``-`` where nothing tells the number."""
    cells = []
    for found, factor, digits in (
        (summary.depth_mae_m, 100, 2),
        (summary.miou, 1, 3),
        (summary.object_mae_m, 100, 2),
    ):
        if found is None:
            cells.append("-")
        else:
            error = found.standard_error
            told = "-" if error is None else f"{factor * error:.{digits}f}"
            cells.append(f"{factor * found.mean:.{digits}f} ± {told}")
    return cells[0], cells[1], cells[2]
