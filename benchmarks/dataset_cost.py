"""Scene pairs an hour on this machine, the time of each stage of a dataset, and an estimate for clusters.

The first table renders as ``night-render`` does: with the same queue and worker processes, which share the
threads of the CPU. Warm-up scenes, which start the workers and compile their kernels, do not count. The
second table has the other stages, too. The time of the scheduler is measured with empty jobs. In the third
table, the time per scene is the larger of two times: that of a scene divided by the number of workers, and
that of the scheduler. A worker is a machine like this one. Run:

    .venv/bin/python benchmarks/dataset_cost.py --size 160x120
"""

import argparse
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from model.data.shards import open_shards
from model.settings.fresh import FreshScenes
from model.training.fresh.workers import FreshWorkers, Rendering
from processes.cores import usable_cores
from render.farm.clusters import connected
from render.farm.jobs import Job, Outcome
from render.farm.queue import RenderQueue
from render.options import BatchedOptions
from render.settings import RenderSettings
from scenegen import Dataset, load_preset, open_dataset

RATES = (("40x30", 0.02), ("80x60", 0.01), ("160x120", 0.01))  # size and error of the first table
WARM_UP = 42  # scenes, six of each class: so each of a few workers compiles the kernels of all classes
AT_ONCE = 218  # scenes of 80 x 60 pixels that a worker of a training renders at once
NO_OPS = 10_000
WORKERS = (1, 8, 64)
SCENES = (1344, 100_000)


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="160x120", help="image size of the stages, default 160x120")
    parser.add_argument("--scenes", type=int, default=70, help="scenes rendered to phasors, default 70")
    parser.add_argument(
        "--transients", type=int, default=14, help="scenes rendered to transients, default 14"
    )
    parser.add_argument("--error", type=float, default=0.01, help="error of the stages, default 0.01")
    parser.add_argument("--warm-up", type=int, default=WARM_UP, help=f"scenes, default {WARM_UP}")
    parser.add_argument("--rates-only", action="store_true", help="print the first table only")
    parser.add_argument(
        "--rates",
        nargs=2,
        action="append",
        metavar=("SIZE", "ERROR"),
        help="a row of the first table, such as 80x60 0.04; may be repeated",
    )
    parser.add_argument("--preset", default="paper", help="preset of the scenes, default paper")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        print_rates(Path(folder), given)
        print_fresh(given)
        if not given.rates_only:
            print_stages(Path(folder), given)


def print_rates(root: Path, given: argparse.Namespace) -> None:
    """The first table: one worker with all cores, and one worker for each core."""
    cores = usable_cores()
    print(f"preset {given.preset}, {given.scenes} scenes after {given.warm_up} to warm up, {cores} cores\n")
    print("| pixels | error | workers x threads | seconds per scene pair | scene pairs per hour |")
    print("|---|---|---|---|---|")
    rates = [(size, float(error)) for size, error in given.rates or ()] or RATES
    for number, (size, error) in enumerate(rates):
        settings = settings_at(size, error)
        for workers in sorted({1, cores}):
            made = root / f"rate-{number}-{workers}"
            dataset = made_dataset(made, given.preset, given.scenes + given.warm_up)
            with local(workers, settings.device) as client:
                seconds = render_cost(client, dataset, settings, dataset.ids(), given.warm_up)
            row = (size, f"{error:.0%}", f"{workers} x {cores // workers}", f"{seconds:.3f}")
            print(f"| {' | '.join(row)} | {3600 / seconds:,.0f} |", flush=True)


def print_fresh(given: argparse.Namespace) -> None:
    """Scene pairs that workers with all cores deliver to a training, without files."""
    cores = usable_cores()
    print("\n| delivered to a training: pixels | error | scene pairs per hour |\n|---|---|---|")
    for size, error in [(size, float(error)) for size, error in given.rates or ()] or RATES:
        width, height = (int(number) for number in size.split("x"))
        scenes = FreshScenes(load_preset(given.preset)).with_seed(0)
        workers = FreshWorkers(Rendering(scenes, {}, width, height, error, "cpu", cores), 1)
        lists = iter([list(range(start, start + AT_ONCE)) for start in range(0, 8 * AT_ONCE, AT_ONCE)])
        results = workers.results(lists)
        next(results)
        next(results)  # the first ones compile the kernels
        started = time.perf_counter()
        count = sum(len(block) for block in results)
        seconds = (time.perf_counter() - started) / count
        workers.close()
        print(f"| {size} | {error:.0%} | {3600 / seconds:,.0f} |", flush=True)


def print_stages(root: Path, given: argparse.Namespace) -> None:
    """The second and the third table, with one worker for each core."""
    cores = usable_cores()
    scenes = {"scenes (Blender, 1344 of them)": made_scenes(root / "scenes", given.preset, 1344) / 1344}
    settings = settings_at(given.size, given.error)
    dataset = made_dataset(root / "data", given.preset, given.scenes + given.warm_up)
    ids = dataset.ids()
    with local(cores, settings.device) as client:
        phasors = render_cost(client, dataset, settings, ids, given.warm_up)
        both, some = replace(settings, product="both"), ids[: given.warm_up + given.transients]
        transients = render_cost(client, dataset, both, some, given.warm_up)
    costs = scenes | {
        "phasors (itof)": phasors,
        "transients and phasors": transients,
        "shards": shard_cost(dataset),
    }
    report(costs, scheduler_cost(dataset), given)


def local(workers: int, device: Any) -> Any:
    """The worker processes of this machine, as ``night-render`` starts them."""
    return connected(workers=workers, scheduler=None, cluster_file=None, device=device)


def settings_at(size: str, error: float) -> RenderSettings:
    """Settings for images of a size, such as ``80x60``."""
    width, height = (int(number) for number in size.split("x"))
    return RenderSettings(options=BatchedOptions(error=error), resolution=(width, height))


def made_dataset(root: Path, preset: str, count: int) -> Dataset:
    """A dataset of a preset."""
    made_scenes(root, preset, count)
    return open_dataset(root)


def made_scenes(root: Path, preset: str, count: int) -> float:
    """Seconds that night-gen takes for a dataset. A process with Blender could not spawn workers later."""
    night_gen = Path(sys.executable).with_name("night-gen")
    command = [night_gen, "scenes", root, "--preset", preset, "--count", str(count)]
    started = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def render_cost(
    client: Any, dataset: Dataset, settings: RenderSettings, ids: list[str], warm_up: int
) -> float:
    """Seconds per scene with workers whose kernels are compiled."""
    dataset.renders.mkdir(exist_ok=True)  # night-render has done this before it gives out scenes
    queue = RenderQueue(client, dataset, settings, f"run-{settings.product}", lambda *_: None)
    queue.run(ids[:warm_up])
    started = time.perf_counter()
    tally = queue.run(ids[warm_up:])
    seconds = time.perf_counter() - started
    if tally.failures or tally.counts["rendered"] != len(ids):
        raise SystemExit(f"not all scenes were rendered: {dict(tally.counts)}, {tally.failures}")
    return seconds / len(ids[warm_up:])


def shard_cost(dataset: Dataset) -> float:
    """Seconds per scene to build the shards for training."""
    started = time.perf_counter()
    open_shards(dataset)
    return (time.perf_counter() - started) / len(dataset.ids())


def no_op(job: Job) -> list[Outcome]:
    """A job that does nothing."""
    return [Outcome(each, "rendered") for each in job.scene_ids]


def scheduler_cost(dataset: Dataset) -> float:
    """Seconds per job that the queue and the scheduler need."""
    with local(2, "cpu") as client:
        queue = RenderQueue(client, dataset, RenderSettings(), "no-op", lambda *_: None, work=no_op)
        queue.run(f"{number:06d}" for number in range(100))
        started = time.perf_counter()
        queue.run(f"{number:06d}" for number in range(NO_OPS))
        return (time.perf_counter() - started) / NO_OPS


def report(costs: dict[str, float], overhead: float, given: argparse.Namespace) -> None:
    """Print the measured times and the estimate."""
    cores = usable_cores()
    print(f"\n{given.size} pixels, hidden-signal error {given.error}, {cores} workers with one thread each\n")
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
