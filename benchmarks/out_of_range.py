"""What a network makes of corners, walls, objects and noise that it was not trained on.

Each row is a small dataset with one change against the preset `paper`, made and rendered at the network's
image size and judged as any other. The wall that stands elsewhere really does: the object's mirror image
moves along, and the network is not told. The meshes are made here: an armchair, an L, a rabbit of ellipsoids,
and two balls apart from each other. A box of a person's size stands upright in the hidden region. Noise is
Gaussian in each component, relative to the amplitude at the first frequency. Datasets stay in --out, so that
an interrupted table continues.

Run:

    .venv/bin/python benchmarks/out_of_range.py night-40x30 --out ranges
"""

import argparse
import subprocess
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from ablations import cells, judged
from numpy.typing import NDArray

from model.data.shards import open_shards
from model.prediction.predictor import load
from scenegen import open_dataset
from scenegen.object_settings import ShapeSizes
from scenegen.shapes import PRIMITIVES

Phasors = NDArray[np.complexfloating]
TERMINAL = Path(sys.executable).parent  # where the commands are


@dataclass(frozen=True)
class Row:
    """One line of the table: its words, dataset, lines of the preset, options of night-render, and noise."""

    words: str
    name: str
    preset: str = ""
    options: tuple[str, ...] = ()
    noise: float = 0.0


def sizes(factor: float) -> str:
    """Preset lines with the sizes of all primitives, times `factor`."""
    own = ShapeSizes()
    lines = [f"{name} = {[round(factor * side, 4) for side in own.of(name)]}" for name in PRIMITIVES]
    return "[hidden_object.size_m]\n" + "\n".join(lines)


ROWS = (
    Row("as trained", "plain"),
    *(Row(f"noise {noise:g}", "plain", noise=noise) for noise in (1e-4, 3e-4, 1e-3, 3e-3)),
    Row(
        *("wall 1 cm farther, turned by 1 degree", "wall1"),
        "[relay_wall]\nlocation_m = [-0.01, 0, 2]\nrotation_deg = [0, 90, 1]",
    ),
    Row(
        *("wall 5 cm farther, turned by 3 degrees", "wall5"),
        "[relay_wall]\nlocation_m = [-0.05, 0, 2]\nrotation_deg = [0, 90, 3]",
    ),
    Row("roughness of the wall 0.2", "glossy", "[relay_wall]\nroughness = [0.2]"),
    Row("diffuse wall", "diffuse", '[relay_wall]\nmaterial = "diffuse"'),
    Row(
        *("wall that gets darker towards one side, to 0.2 to 1", "gradient"),
        "[relay_wall]\nleast_reflectance = 0.2",
    ),
    Row("object of reflectance 0.3", "dark", "[hidden_object]\nreflectance = 0.3"),
    Row("objects of 0.7 times the size", "small", sizes(0.7)),
    Row("objects of 1.2 times the size", "large", sizes(1.2)),
    Row("objects up to 20 cm farther from the wall", "far", "[hidden_object.location_m]\nx = [1.3, 1.5]"),
    Row("light of up to six bounces", "six", options=("--max-bounces", "6")),
    *(
        Row(words, name, f'[hidden_object]\nshapes = ["mesh:{name}.ply"]\ncomposite_fraction = 0')
        for name, words in (
            *(("armchair", "an armchair"), ("letter", "a letter L")),
            *(("rabbit", "a rabbit"), ("balls", "two balls")),
        )
    ),
    Row(
        *("a box of a person's size, standing", "person"),
        '[hidden_object]\nshapes = ["parallelepiped"]\ncomposite_fraction = 0\n'
        "location_m = { z = [0.95, 1.05] }\nrotation_deg = { x = [0, 0], y = [0, 0] }\n"
        "[hidden_object.size_m]\nparallelepiped = [0.25, 0.45, 1.7]",
    ),
)


def main() -> None:
    """Make, render and judge the datasets, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder, or name of a network that comes with NIGHT")
    parser.add_argument("--out", type=Path, required=True, help="folder of the datasets")
    parser.add_argument("--count", type=int, default=70, help="scenes of each, default 70")
    given = parser.parse_args()
    predictor = load(given.run)
    size = f"{predictor.config.image_width}x{predictor.config.image_height}"
    given.out.mkdir(parents=True, exist_ok=True)
    for name, mesh in meshes().items():
        mesh.export(given.out / f"{name}.ply")
    print("| | MAE cm | mIoU | object MAE cm | no object: MAE cm |\n|---|---|---|---|---|")
    for row in ROWS:
        shards = open_shards(open_dataset(rendered(row, given.out, size, given.count)))
        rows = shards.rows("test")
        found = judged(predictor, shards, rows, partial(with_noise, row.noise, np.random.default_rng(0)))
        block = shards.read(rows)
        nothing_m = float(np.abs(block.radial_depth_m).mean())
        print(f"| {row.words} | {cells(found)} | {100 * nothing_m:.2f} |", flush=True)


def with_noise(deviation: float, rng: np.random.Generator, phasors: Phasors) -> Phasors:
    """Phasors (n, H, W, F) with noise in each component, relative to the amplitude at the first frequency."""
    draw = rng.standard_normal((*phasors.shape, 2)) @ np.array([1, 1j])
    noisy: Phasors = phasors + deviation * np.abs(phasors[..., :1]) * draw
    return noisy


def rendered(row: Row, out: Path, size: str, count: int) -> Path:
    """The dataset of a row, made and rendered as far as it is not."""
    preset, dataset = out / f"{row.name}.toml", out / row.name
    head = f"[dataset]\ncount = {count}\nseed = 11\ntest_fraction = 1.0\nvalidation_fraction = 0.0\n"
    preset.write_text(f"{head}{row.preset}\n")
    for program, *words in (
        ("night-gen", "scenes", str(dataset), "--preset", str(preset)),
        *[("night-render", str(dataset), "--product", "itof", "--resolution", size, *row.options)],
    ):
        done = subprocess.run([TERMINAL / program, *words], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{row.words}: {done.stderr.strip().splitlines()[-1]}")
    return dataset


def meshes() -> dict[str, trimesh.Trimesh]:
    """Shapes that no network has seen; the programs scale them to 0.5 m."""

    def box(size: tuple[float, float, float], centre: tuple[float, float, float]) -> trimesh.Trimesh:
        return trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre))

    def ellipsoid(radii: tuple[float, float, float], centre: tuple[float, float, float]) -> trimesh.Trimesh:
        return trimesh.creation.icosphere(3).apply_scale(radii).apply_translation(centre)

    armchair = [
        box((0.7, 0.7, 0.35), (0, 0, 0.175)),
        box((0.7, 0.15, 0.5), (0, 0.275, 0.6)),
        box((0.12, 0.55, 0.25), (-0.29, -0.075, 0.475)),
        box((0.12, 0.55, 0.25), (0.29, -0.075, 0.475)),
    ]
    letter = [box((0.2, 0.2, 0.9), (0, 0, 0.45)), box((0.4, 0.2, 0.2), (0.3, 0, 0.1))]
    balls = [trimesh.creation.icosphere(3, 0.15).apply_translation((x, 0, 0)) for x in (-0.3, 0.3)]
    rabbit = [
        ellipsoid((0.2, 0.28, 0.22), (0, 0, 0.22)),
        ellipsoid((0.13, 0.15, 0.13), (0, -0.25, 0.47)),
        *(ellipsoid((0.035, 0.05, 0.17), (x, -0.2, 0.68)) for x in (-0.06, 0.06)),
        *(ellipsoid((0.08, 0.16, 0.06), (x, -0.18, 0.06)) for x in (-0.13, 0.13)),
    ]
    parts = {"armchair": armchair, "letter": letter, "rabbit": rabbit, "balls": balls}
    return {name: trimesh.util.concatenate(some) for name, some in parts.items()}


if __name__ == "__main__":
    main()
