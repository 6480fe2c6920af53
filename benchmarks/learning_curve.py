r"""Learning curve: the error of a network by the number of scenes that it was trained on.

Every network sees about the same number of samples, so that fewer scenes are seen more often; or each sees as
many as are given for it. Its weights are those of the epoch that is best on the validation scenes, so that a
network which has learnt its scenes by heart is stopped. All networks are judged on the same scenes, which
none has seen. A power law MAE = a · scenes^-b is fitted to the table; what it says beyond the largest number
of scenes is an extrapolation. Interrupted runs continue.

Run:

    .venv/bin/python benchmarks/learning_curve.py mydata --judge newdata --counts 1000 2000 4000 \
        --samples 100000 --width 16 --block 2 --out curve
"""

import argparse
import logging
from pathlib import Path

import numpy as np
from ablations import cells, judged
from numpy.typing import ArrayLike

from model.data.shards import open_shards
from model.prediction.predictor import load
from model.settings.keys import merged
from model.settings.presets import training_preset
from model.settings.train_settings import settings_from_dict
from model.training.loop import train
from scenegen import open_dataset

WANTED_CM = (1.6, 1.0)


def main() -> None:
    """Train and judge one network for each number of scenes, then fit the power law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--judge", type=Path, required=True, help="dataset whose test scenes judge")
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--counts", type=int, nargs="+", required=True, help="numbers of training scenes")
    parser.add_argument(
        "--samples", type=int, nargs="+", required=True, help="samples of a network: one number, or one each"
    )
    parser.add_argument("--preset", default="default", help="training preset, default: default")
    parser.add_argument("--width", type=int, help="channels of the first level, default from --preset")
    parser.add_argument("--block", type=int, help="pixels per side of a position, default from --preset")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if len(given.samples) not in (1, len(given.counts)):
        parser.error("--samples needs one number, or one for each of --counts")
    samples = given.samples * (len(given.counts) // len(given.samples))
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    dataset, unseen = open_dataset(given.dataset), open_shards(open_dataset(given.judge))
    base = training_preset(given.preset)[0]
    sizes = {key: getattr(given, key) for key in ("width", "block") if getattr(given, key)}
    base = merged(base, {"network": sizes})
    lines, errors_cm = [], []
    for count, seen in zip(given.counts, samples, strict=True):
        epochs = max(1, round(seen / count))
        changes = {"train_scenes": count, "max_epochs": epochs, "patience": epochs, "seed": given.seed}
        out = given.out / f"scenes-{count}"
        train(
            *(dataset, out, settings_from_dict(merged(base, {"run": changes}), given.preset)),
            resume=(out / "run.json").is_file(),
        )
        found = judged(load(out), unseen, unseen.rows("test"))
        errors_cm.append(100 * found.depth_mae_m.mean)
        lines.append(f"| {count} | {epochs} | {cells(found)} |")
        print(lines[-1], flush=True)
    print("\n| training scenes | epochs | MAE cm | mIoU | object MAE cm |\n|---|---|---|---|---|")
    print("\n".join(lines))
    if len(given.counts) > 1:
        print("\n" + power_law(given.counts, errors_cm))


def power_law(counts: ArrayLike, errors_cm: ArrayLike) -> str:
    """The power law through the errors, and the scenes that it asks for."""
    slope, start = np.polyfit(np.log(counts), np.log(errors_cm), 1)
    if slope >= 0:
        return "The error does not fall with the number of scenes."
    asked = ", ".join(f"{np.exp((np.log(cm) - start) / slope):,.0f} for {cm:g} cm" for cm in WANTED_CM)
    return f"MAE = {np.exp(start):.1f} cm · scenes^{slope:.2f}; scenes by this law: {asked}"


if __name__ == "__main__":
    main()
