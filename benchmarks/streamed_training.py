"""Speed of a training whose scenes stay in memory, and of one that streams them from the disk.

The dataset is synthetic; its scenes are copies of one. The network is that of a training preset. Streamed
scenes have memory for a third of them. Run, on an idle machine:

    .venv/bin/python benchmarks/streamed_training.py [--scenes 3000] [--size 80x60] [--preset default]
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from shard_cost import make_dataset

from model.data.shards import open_shards
from model.settings.keys import merged, tables
from model.settings.presets import training_preset
from model.settings.train_settings import TrainSettings, settings_from_dict
from model.training import loop
from scenegen import Dataset, open_dataset

EPOCHS = 3


def main() -> None:
    """Train both ways and print a line for each epoch."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--scenes", type=int, default=3000)
    arguments.add_argument("--size", default="80x60")
    arguments.add_argument("--preset", default="default")
    arguments.add_argument("--block", type=int, default=4, help="pixels per side of a block, default 4")
    arguments.add_argument("--batch-size", type=int, default=32)
    given = arguments.parse_args()
    width, height = map(int, given.size.split("x"))
    changes = {
        "network.block": given.block,
        "optimiser.batch_size": given.batch_size,
        "optimiser.algorithm": "adam",  # whose steps take no time to speak of
        "run.max_epochs": EPOCHS,
        "run.progress": False,
        "run.checkpoint_minutes": 1e3,
        "input.channels.bounce_images": False,
    }
    preset, origin = training_preset(given.preset)
    settings = settings_from_dict(merged(preset, tables(changes)), origin)
    with TemporaryDirectory() as folder:
        make_dataset(Path(folder) / "data", given.scenes, width, height)
        dataset = open_dataset(Path(folder) / "data")
        row_bytes = open_shards(dataset, ground_truth=settings.run.ground_truth).manifest.layout.row_bytes
        print(f"| {given.size}, batches of {given.batch_size} | epoch | samples/s |\n|---|---|---|")
        for way, memory_bytes in (("streamed", given.scenes * row_bytes // 3), ("in memory", None)):
            rates = epoch_rates(dataset, Path(folder) / way, settings, memory_bytes)
            for epoch, rate in enumerate(rates, 1):
                print(f"| {way} | {epoch} | {rate:.0f} |", flush=True)


def epoch_rates(
    dataset: Dataset, out: Path, settings: TrainSettings, memory_bytes: int | None
) -> list[float]:
    """Training samples per second in each epoch, without validation."""
    rates, train_epoch = [], loop.train_epoch

    def timed(state, *rest):
        started = time.perf_counter()
        loss = train_epoch(state, *rest)
        rates.append(len(state.feeds["train"].rows) / (time.perf_counter() - started))
        return loss

    with patch.object(loop, "train_epoch", timed):
        loop.train(dataset, out, settings, memory_bytes=memory_bytes)
    return rates


if __name__ == "__main__":
    main()
