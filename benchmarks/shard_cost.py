"""Time and memory to build shards, to open them and to read them once, on a synthetic dataset.

Each step runs in a separate process, because memory is the peak of the process. The first line is for the
imports alone. Streaming keeps one piece in memory and reads the next one ahead. Before each epoch, the
system is asked to drop the shards from its disk cache. Run:

    .venv/bin/python benchmarks/shard_cost.py [--scenes 160] [--size 320x240]
"""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parent.parent
STEPS = {
    "imports": "importing alone",
    "build": "first build",
    "build, open again": "open again, unchanged",
    "changed": "open after one changed scene",
    "resident": "one epoch, resident",
    "streamed": "one epoch, streamed",
}


def measure(step: str, folder: Path) -> None:
    """Do one step in this process; print its time in seconds, peak memory in MB, and MB read."""
    import torch

    from model.data.feed import Feed
    from model.data.shards import open_shards
    from scenegen import open_dataset

    read = 0
    started = time.perf_counter()
    if step != "imports":
        shards = open_shards(open_dataset(folder))
        if step in ("resident", "streamed"):
            rows = shards.rows("train")
            forget(shards.folder)
            started = time.perf_counter()
            feed = Feed(shards, rows, len(rows) if step == "resident" else 0)
            for block in feed.in_windows(feed.shuffled_windows(torch.Generator().manual_seed(0)), 32):
                read += len(block) * shards.manifest.layout.row_bytes
    seconds = time.perf_counter() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(seconds, peak, read / 1e6)


def make_dataset(folder: Path, count: int, width: int, height: int) -> None:
    """Write closed-form scenes of the tests. All have copies of one render, because writing EXR is slow."""
    sys.path.insert(0, str(ROOT / "tests"))
    from synthetic_dataset import write_synthetic_dataset, write_synthetic_render

    dataset = write_synthetic_dataset(folder, count=count, width=4, height=3)
    first, *others = dataset.ids()
    write_synthetic_render(dataset, dataset.scene(first), width, height)
    for scene in others:
        shutil.copytree(dataset.render_folder(first), dataset.render_folder(scene), dirs_exist_ok=True)


def forget(folder: Path) -> None:
    """Ask the system to drop the shards from its disk cache."""
    for file in folder.rglob("*.npy"):
        descriptor = os.open(file, os.O_RDONLY)
        os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        os.close(descriptor)


def change_scene(folder: Path) -> None:
    """Make the measurement of a scene in the middle 1 % brighter."""
    from itof import read_image, write_image
    from scenegen import open_dataset

    dataset = open_dataset(folder)
    file = dataset.render_folder(dataset.ids()[len(dataset.ids()) // 2]) / "itof.exr"
    image = read_image(file)
    write_image(file, {n: np.float32(1.01) * values for n, values in image.channels.items()}, {})


def main() -> None:
    """Make the dataset and print a line for every step."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--scenes", type=int, default=160)
    arguments.add_argument("--size", default="320x240")
    arguments.add_argument("--step", help=argparse.SUPPRESS)
    arguments.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.step:
        measure(given.step, given.folder)
        return
    width, height = (int(part) for part in given.size.split("x"))
    with TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        make_dataset(data, given.scenes, width, height)
        print(f"{given.scenes} scenes of {width} x {height} pixels")
        print(f"{'step':<32}{'seconds':>9}{'peak MB':>9}{'MB/s':>9}")
        for step, name in STEPS.items():
            if step == "changed":
                change_scene(data)
            command = [sys.executable, __file__, "--step", step, "--folder", str(data)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            seconds, peak, read = (float(word) for word in done.stdout.split())
            rate = f"{read / seconds:9.0f}" if read else f"{'-':>9}"
            print(f"{name:<32}{seconds:9.2f}{peak:9.0f}{rate}")


if __name__ == "__main__":
    main()
