"""Time of each stage of a dataset on this machine, and an estimate for 1344 and 100,000 scenes.

The time of the scheduler is measured with empty jobs. The estimated time per scene is the larger of two
times: that of a scene divided by the number of workers, and that of the scheduler. A worker is a machine
like this one. Run:

    .venv/bin/python benchmarks/dataset_cost.py --size 160x120
"""

import argparse
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from model.data.shards import open_shards
from render.farm.clusters import connected
from render.farm.jobs import Job, Outcome
from render.farm.queue import RenderQueue
from render.options import ManyLightOptions
from render.settings import RenderSettings
from scenegen import Dataset, open_dataset

WARM_UP = 7  # scenes, one of each class, that compile all kernels
NO_OPS = 10_000
WORKERS = (1, 8, 64)
SCENES = (1344, 100_000)


def main() -> None:
    """Measure all stages and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="160x120", help="image size, default 160x120")
    parser.add_argument("--scenes", type=int, default=28, help="scenes to render to phasors, default 28")
    parser.add_argument(
        "--transients", type=int, default=14, help="scenes to render to transients, default 14"
    )
    parser.add_argument("--error", type=float, default=0.01, help="error of the hidden signal, default 0.01")
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    with TemporaryDirectory() as folder:
        root = Path(folder)
        costs = {"scenes (Blender, 1344 of them)": made_scenes(root / "scenes", (320, 240), 1344) / 1344}
        settings = RenderSettings(options=ManyLightOptions(error=given.error))
        made_scenes(root / "data", (width, height), given.scenes)
        dataset = open_dataset(root / "data")
        with connected(workers=1, scheduler=None, cluster_file=None, device="auto") as client:
            costs["phasors (itof)"] = render_cost(client, dataset, settings, given.scenes)
            both = replace(settings, product="both")
            costs["transients and phasors"] = render_cost(client, dataset, both, given.transients)
        costs["shards"] = shard_cost(dataset)
        overhead = scheduler_cost(dataset)
    report(costs, overhead, given)


def made_scenes(root: Path, size: tuple[int, int], count: int) -> float:
    """Seconds that night-gen takes for a dataset. A process with Blender could not spawn workers later."""
    preset = root.with_suffix(".toml")
    preset.write_text(f"[camera]\nwidth = {size[0]}\nheight = {size[1]}\n")
    night_gen = Path(sys.executable).with_name("night-gen")
    command = [night_gen, "scenes", root, "--preset", preset, "--count", str(count)]
    started = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def render_cost(client: object, dataset: Dataset, settings: RenderSettings, count: int) -> float:
    """Seconds per scene with one worker whose kernels are compiled."""
    ids = dataset.ids()[:count]
    queue = RenderQueue(client, dataset, settings, "warm-up", lambda *_: None)
    queue.run(ids[:WARM_UP])
    started = time.perf_counter()
    queue.run(ids[WARM_UP:])
    return (time.perf_counter() - started) / (count - WARM_UP)


def shard_cost(dataset: Dataset) -> float:
    """Seconds per scene to build the shards for training."""
    started = time.perf_counter()
    open_shards(dataset)
    return (time.perf_counter() - started) / len(dataset.ids())


def no_op(job: Job) -> Outcome:
    """A job that does nothing."""
    return Outcome(job.scene_id, "rendered")


def scheduler_cost(dataset: Dataset) -> float:
    """Seconds per job that the queue and the scheduler need."""
    with connected(workers=2, scheduler=None, cluster_file=None, device="cpu") as client:
        queue = RenderQueue(client, dataset, RenderSettings(), "no-op", lambda *_: None, work=no_op)
        queue.run(f"{number:06d}" for number in range(100))
        started = time.perf_counter()
        queue.run(f"{number:06d}" for number in range(NO_OPS))
        return (time.perf_counter() - started) / NO_OPS


def report(costs: dict[str, float], overhead: float, given: argparse.Namespace) -> None:
    """Print the measured times and the estimate."""
    cores = len(os.sched_getaffinity(0))
    print(f"{given.size} pixels, hidden-signal error {given.error}, {cores} cores\n")
    print("| stage | seconds per scene | scenes per hour |\n|---|---|---|")
    for stage, seconds in costs.items():
        print(f"| {stage} | {seconds:.3g} | {3600 / seconds:,.0f} |")
    print(
        f"| scheduler alone ({NO_OPS:,} empty jobs, two workers) | {overhead:.2g} | {3600 / overhead:,.0f} |"
    )
    header = " | ".join(f"{count:,} on {workers}" for count in SCENES for workers in WORKERS)
    print(f"\n| hours for scenes on workers | {header} |\n|---|{'---|' * len(SCENES) * len(WORKERS)}")
    for stage in ("phasors (itof)", "transients and phasors"):
        hours = [
            count * max(costs[stage] / workers, overhead) / 3600 for count in SCENES for workers in WORKERS
        ]
        print(f"| {stage} | {' | '.join(f'{h:.2g}' if h < 10 else f'{h:.0f}' for h in hours)} |")


if __name__ == "__main__":
    main()
