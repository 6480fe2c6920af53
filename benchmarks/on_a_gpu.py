"""Checks CUDA against LLVM and measures a GPU, in less than 8 minutes: the answers are one JSON file.

- agreement: each method renders seven scenes to all its products on both devices. Numbers are norms of the
  difference, relative to the hidden signal for phasors of `batched` and `many-light`, else to all light.
- rendering, training, prediction: commands on the device, `train_throughput.py` and `latency.py`. A network
  predicts the same images on both devices.

A command that fails or needs too long is recorded with what it printed last; the others go on. With
``--device cpu``, the script checks itself: all of it, in small, on the CPU. Run:

    .venv/bin/python benchmarks/on_a_gpu.py --out gpu.json
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from seven_scenes import made_datasets

import model
from itof import DepthMap, TransientReader, read_image
from render.backend import BackendError, select_variant
from scenegen import Dataset

PLACES = Path(sys.executable).parent, Path(__file__).parent  # of the commands and of the benchmarks
SECONDS = 470  # for all of it
OTHERS = 1e-3  # most that two devices may differ, but for hidden signals with a promised error
PRODUCTS = 13  # of all methods: phasors, mask and depth of each, and two transients of two


@dataclass(frozen=True)
class Sizes:
    """What is measured on a GPU, or in a check of this script."""

    error: float
    small: tuple[int, int]
    large: tuple[int, int]
    scenes: int
    training: list[str]
    throughput: list[str]
    latency: list[str]

    def methods(self) -> dict[str, list[str]]:
        """Options of night-render, by method."""
        error = ["--error", f"{self.error}"]
        return {
            "batched": ["--product", "itof", "--method", "batched", *error],
            "many-light": ["--product", "both", "--method", "many-light", *error],
            "path": ["--product", "both", "--method", "path", "--spp", "64"],
        }

    def allowed(self, method: str, product: str) -> float:
        """Most that devices may differ: rounding may change the number of lights, and both keep the error."""
        return 2**0.5 * self.error if product == "phasors" and method != "path" else OTHERS


ON_GPU = Sizes(
    *(0.01, (80, 60), (320, 240), 504, ["--preset", "demo", "--max-epochs", "3"]),
    ["--size", "80x60", "--size", "320x240", "--seconds", "5"],
    ["--seconds", "5"],
)
SELF_CHECK = Sizes(
    *(0.2, (20, 15), (40, 30), 14, ["--preset", "demo", "--max-epochs", "1"]),
    ["--size", "20x15", "--seconds", "0.1", "--width", "8", "--batch-size", "2"],
    ["--size", "40x30", "--seconds", "0.1"],
)


@dataclass
class Work:
    """The folder and the device of the measurements, and what they found."""

    folder: Path
    device: str
    sizes: Sizes
    end: float
    found: dict[str, Any] = field(default_factory=dict)

    def command(self, name: str, *words: object) -> str | None:
        """Output of a program of NIGHT or of a benchmark, whose seconds are noted; None if it fails."""
        place = PLACES[name.endswith(".py")] / name
        line = [*([sys.executable] if name.endswith(".py") else []), str(place), *map(str, words)]
        print(f"{self.left_s:4.0f} s left: {name}", *words, file=sys.stderr, flush=True)
        began = time.perf_counter()
        try:
            done = subprocess.run(line, capture_output=True, text=True, timeout=max(1, self.left_s))
            problem = None if done.returncode == 0 else f"exit code {done.returncode}: {done.stderr[-500:]}"
        except subprocess.TimeoutExpired:
            problem = "no time was left"
        noted = {"command": " ".join([name, *map(str, words)]), "seconds": time.perf_counter() - began}
        self.found.setdefault("commands", []).append(noted | ({"problem": problem} if problem else {}))
        return None if problem else done.stdout

    @property
    def left_s(self) -> float:
        """Seconds until the measurements must end."""
        return self.end - time.perf_counter()


def main() -> None:
    """Measure, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("gpu.json"))
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda")
    given = parser.parse_args()
    seconds = SECONDS if given.device == "cuda" else 4 * SECONDS
    end = time.perf_counter() + seconds
    try:
        variant = select_variant(given.device)
    except BackendError as error:
        raise SystemExit(str(error)) from None
    if given.device == "cuda" and not torch.cuda.is_available():
        raise SystemExit("PyTorch finds no CUDA GPU here: install its CUDA build, or give --device cpu")
    gpu = torch.cuda.get_device_name() if given.device == "cuda" else None
    sizes = ON_GPU if given.device == "cuda" else SELF_CHECK
    with TemporaryDirectory() as folder:
        work = Work(Path(folder), given.device, sizes, end)
        work.found |= {"gpu": gpu, "variant": variant, "torch": torch.__version__}
        seven, large, many = datasets(work)
        rows = work.found["agreement"] = agreement(work, seven)
        measure(work, large, many)
        agrees = len(rows) == PRODUCTS and all(max(row["differences"]) <= row["allowed"] for row in rows)
        problems = [each for each in work.found["commands"] if "problem" in each]
        work.found |= {"agrees": agrees, "seconds": seconds - work.left_s}
        given.out.write_text(json.dumps(work.found, indent=2) + "\n")
    verdict = "both devices agree" if agrees else "the devices differ: see agreement"
    print(f"{given.out}: {verdict}; {len(problems)} commands failed")
    raise SystemExit(0 if agrees and not problems else 1)


def datasets(work: Work) -> list[Dataset]:
    """Seven small scenes, seven large ones and many small ones."""

    def preset(size: tuple[int, int], count: int) -> dict[str, Any]:
        camera = {"width": size[0], "height": size[1]}
        return {"dataset": {"count": count}, "camera": camera, "transient": {"bin_count": 1200}}

    sizes = work.sizes
    wanted = {"seven": (sizes.small, 7), "large": (sizes.large, 7), "many": (sizes.small, sizes.scenes)}
    return made_datasets({work.folder / name: preset(*each) for name, each in wanted.items()})


def agreement(work: Work, seven: Dataset) -> list[dict[str, Any]]:
    """Differences of all products of the renderer on both devices, by method, product and scene."""
    rows = []
    for method, options in work.sizes.methods().items():
        places = {device: work.folder / f"{method}_{device}" for device in ("cpu", "device")}
        for device, place in places.items():
            shutil.copytree(seven.root, place)
            chosen = "cpu" if device == "cpu" else work.device
            work.command("night-render", place, *options, "--device", chosen)
        found: dict[str, list[float]] = {}
        for scene_id in seven.ids():
            pair = [place / "renders" / scene_id for place in places.values()]
            for product, value in differences(*pair, relative_to_hidden=method != "path"):
                found.setdefault(product, []).append(value)
        rows += [
            {
                "method": method,
                "product": product,
                "differences": values,
                "allowed": work.sizes.allowed(method, product),
            }
            for product, values in found.items()
        ]
    return rows


def differences(one: Path, two: Path, *, relative_to_hidden: bool) -> Iterator[tuple[str, float]]:
    """Each product that both folders have, and how far they differ."""
    if not (one / "itof.exr").exists() or not (two / "itof.exr").exists():
        return
    images = [read_image(folder / "itof.exr") for folder in (one, two)]
    part = "hidden" if relative_to_hidden else "itof"
    yield "phasors", change(*(image.phasors(part)[0] for image in images))
    truths = [DepthMap.of_image(read_image(folder / "mirrored.exr")) for folder in (one, two)]
    masks = [truth.mask for truth in truths]
    yield "mask", float((masks[0] != masks[1]).mean())
    both = masks[0] & masks[1]
    depths = [truth.radial_depth_m[both] for truth in truths]
    yield "depth_m", float(np.abs(depths[0] - depths[1]).max(initial=0))
    for name in ("transient", "mirrored_transient"):
        files = [folder / f"{name}.exr" for folder in (one, two)]
        if all(file.exists() for file in files):
            yield name, change(*map(bins, files))


def bins(file: Path) -> np.ndarray:
    """(H, W, T) a transient."""
    with TransientReader(file) as reader:
        return np.concatenate(list(reader.row_blocks()))


def change(one: np.ndarray, two: np.ndarray) -> float:
    """Norm of the difference, relative to the first."""
    return float(np.linalg.norm(two - one) / np.linalg.norm(one))


def measure(work: Work, large: Dataset, many: Dataset) -> None:
    """Rendering, training and prediction on the device; their seconds are those of the commands."""
    device, methods = ["--device", work.device], work.sizes.methods()
    for method in ("batched", "many-light"):
        work.command("night-render", large.root, *methods[method], *device, "--again", "changed")
    work.command("night-render", many.root, *methods["batched"], *device)
    run = work.folder / "run"
    work.command("night-train", many.root, "--out", run, *work.sizes.training, *device)
    work.found["prediction_differences_m"] = predictions(work, many, run)
    for name, options in (("train_throughput.py", work.sizes.throughput), ("latency.py", work.sizes.latency)):
        work.found[name] = (work.command(name, *options, *device) or "").splitlines()


def predictions(work: Work, many: Dataset, run: Path) -> list[float]:
    """Mean absolute difference of the depths of both devices, metres, for the first seven scenes."""
    if not (run / "best.safetensors").exists():
        return []
    networks = [model.load(run, device) for device in ("cpu", work.device)]
    found = []
    for scene_id in many.ids()[:7]:
        phasors, _ = read_image(many.render_folder(scene_id) / "itof.exr").phasors()
        depths = [network.predict(phasors).radial_depth_m for network in networks]
        found.append(float(np.abs(depths[0] - depths[1]).mean()))
    return found


if __name__ == "__main__":
    main()
