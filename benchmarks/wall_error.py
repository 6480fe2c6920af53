"""Effect of a wall that is not where the run has it, and of phases that drifted: metrics for several errors.

The measurements stay the same. The wall that the run knows is moved along its normal and turned about the
vertical; the phases of all frequencies are changed, with alternating signs. Run:

    .venv/bin/python benchmarks/wall_error.py myrun mydata

With --captured, the reference is a capture of the empty corner, which shows the true phases, and its wall
alone is taken to be elsewhere.
"""

import argparse
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from ablations import judged

from itof.wall.empty_corner import captured_at
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallView
from model.data.shards import open_shards
from model.prediction.predictor import Predictor, load
from scenegen import open_dataset

SMALL = [(mm, 0.0, 0.0) for mm in (0, 0.1, 0.2, 0.5, 1, 2, 5, 10)]
CAPTURED = [(100.0, 0.0, 0.0), *((0.0, turn_deg, 0.0) for turn_deg in (0, 0.25, 0.5, 1, 2))]
ERRORS = [*SMALL, (0.0, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 5.0), (10.0, 1.0, 5.0)]  # mm, degrees, mrad


@dataclass(frozen=True)
class WithWall(Predictor):
    """A predictor that takes the wall to be where it is told."""

    known: ExpectedWall | None = None

    def _wall(self, reference: object) -> ExpectedWall | None:
        return self.known


def main() -> None:
    """Evaluate a run on the test split with each error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=400, help="test scenes, default 400")
    parser.add_argument("--captured", action="store_true", help="the phases of the reference are right")
    given = parser.parse_args()
    predictor, shards = load(given.run), open_shards(open_dataset(given.dataset))
    rows = shards.rows("test")[: given.scenes]
    print(f"{len(rows)} test scenes\n")
    print("| wall off by | turned by | phases off by | MAE cm | mIoU |\n|---|---|---|---|---|")
    for error_mm, turn_deg, offset_mrad in CAPTURED if given.captured else ERRORS:
        view = moved_wall(predictor.config.geometry, error_mm / 1000, turn_deg)
        moved = replace(predictor, config=replace(predictor.config, geometry=view))
        if given.captured:
            own = {each.name: getattr(predictor, each.name) for each in fields(predictor)}
            there = captured_at(predictor.reference, predictor.wall, moved.wall.plane_per_m)
            moved = WithWall(**own, known=there)
        signs = (-1.0) ** np.arange(len(predictor.config.inputs.frequencies_hz))
        turn = np.exp(1j * offset_mrad / 1000 * signs)  # (F,)
        summary = judged(moved, shards, rows, partial(np.multiply, turn))
        mae_cm, miou = 100 * summary.depth_mae_m.mean, summary.miou.mean
        cells = f"{error_mm:g} mm | {turn_deg:g} degrees | {offset_mrad:g} mrad"
        print(f"| {cells} | {mae_cm:.2f} | {miou:.3f} |", flush=True)


def moved_wall(view: WallView, error_m: float, turn_deg: float) -> WallView:
    """The view with the wall moved by `error_m` away from the room, and turned about the vertical."""
    normal = np.array(view.wall_normal)
    point_m = np.array(view.wall_point_m) - error_m * normal
    cosine, sine = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return replace(view, wall_point_m=tuple(point_m.tolist()), wall_normal=tuple((turn @ normal).tolist()))


if __name__ == "__main__":
    main()
