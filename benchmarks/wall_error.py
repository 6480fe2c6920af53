"""Effect of a wrong position of the relay wall: metrics for several errors in mm.

The measurement stays the same. The wall of the computed direct return is moved along its normal. Run:

    .venv/bin/python benchmarks/wall_error.py myrun mydata
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from ablations import judged

from model.data.shards import open_shards
from model.network.wall_view import WallView
from model.prediction.predictor import load
from scenegen import open_dataset


def main() -> None:
    """Evaluate a run on the test split with each error of the wall."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=400, help="test scenes, default 400")
    parser.add_argument("--errors-mm", type=float, nargs="+", default=[0, 0.1, 0.2, 0.5, 1, 2, 5])
    given = parser.parse_args()
    predictor, shards = load(given.run), open_shards(open_dataset(given.dataset))
    config, rows = predictor.config, shards.rows("test")[: given.scenes]
    size = (config.image_width, config.image_height)
    print(f"{len(rows)} test scenes\n\n| wall off by | MAE cm | mIoU |\n|---|---|---|")
    for error_mm in given.errors_mm:
        view = moved_wall(config.geometry, error_mm / 1000)
        reference = view.direct_phasors(*size, config.inputs.frequencies_hz)
        summary = judged(predictor, shards, rows, reference)
        mae_cm, miou = 100 * summary.depth_mae_m.mean, summary.miou.mean
        print(f"| {error_mm:g} mm | {mae_cm:.2f} | {miou:.3f} |", flush=True)


def moved_wall(view: WallView, error_m: float) -> WallView:
    """The view with the wall moved by `error_m` against its normal, away from the room."""
    point_m = np.array(view.wall_point_m) - error_m * np.array(view.wall_normal)
    return replace(view, wall_point_m=tuple(point_m.tolist()))


if __name__ == "__main__":
    main()
