"""A preset of many corners with objects of any kind, for the training of `any-corner`.

Two thirds of its scenes have one or two of the paper's primitives. The others have objects of several solids
of any sides (unions, furniture, letters, bent tubes, standing people), two that stand apart, or nothing. An
object of several solids has one orientation; meshes would turn, but their light costs ten times as much.
What `out_of_range.py` judges is not among them, but for a box of the size of a person. The same seed makes
the same preset. Run:

    .venv/bin/python benchmarks/random_objects.py any-object.toml
"""

import argparse
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenegen.shapes import PRIMITIVES

Rng = np.random.Generator
Point = NDArray[np.float64]
SINGLES, COMPOSITES = 32, 5  # tables of each primitive and of each two
EACH = 16  # tables of each other kind
SOLIDS = ("cube", "sphere", "cylinder", "cone")
LETTERS = {  # bars between points x, z and x, z
    "T": ((0, 4, 2, 4), (1, 0, 1, 4)),
    "E": ((0, 0, 0, 4), (0, 4, 2, 4), (0, 2, 2, 2), (0, 0, 2, 0)),
    "F": ((0, 0, 0, 4), (0, 4, 2, 4), (0, 2, 2, 2)),
    "H": ((0, 0, 0, 4), (2, 0, 2, 4), (0, 2, 2, 2)),
    "U": ((0, 0, 0, 4), (2, 0, 2, 4), (0, 0, 2, 0)),
    "Z": ((0, 4, 2, 4), (0, 0, 2, 4), (0, 0, 2, 0)),
}
HEAD = """\
# Written by benchmarks/random_objects.py --seed {seed}: corners of any-corner with objects of any kind.
[dataset]
count = 16000
test_fraction = 0.01
validation_fraction = 0.04

[hidden_object]
location_m = {{ x = [0.9, 1.5], y = [0.5, 1.5], z = [1.1, 2.1] }}
least_reflectance = 0.2
empty_fraction = 0.02

[relay_wall]
least_reflectance = 0.2

[camera_spread]
location_m = 0.3
rotation_deg = 5.0
horizontal_fov_deg = 5.0
"""


@dataclass
class Solid:
    """A primitive with sides, centre and turn in the axes of its object."""

    shape: str
    sides: Point
    centre: Point
    turn: Rotation


def main() -> None:
    """Write the preset."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="preset to write")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    tables = [f'shape = "{shape}"' for shape in PRIMITIVES] * SINGLES
    around = "offset_m = { x = [-0.12, 0.15], y = [-0.12, 0.15], z = [-0.12, 0.15] }"
    for one, two in [*combinations(PRIMITIVES, 2)] * COMPOSITES:
        tables.append(f'shape = "{one}"\n[[object.beside]]\nshape = "{two}"\n{around}')
    for make in (stretched, apart, boxes, balls, mixture, tube, letter, furniture):
        tables += [written(make(rng), rng.uniform(0.4, 0.8), Rotation.random(rng=rng)) for _ in range(EACH)]
    upright = "location_m = { x = [0.9, 1.5], y = [0.5, 1.5], z = [0.8, 1.2] }\n"
    for make in (upright_box, person):
        for _ in range(EACH // 2):
            turn = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
            tables.append(upright + written(make(rng), rng.uniform(1.3, 1.6), turn))
    given.out.write_text(HEAD.format(seed=given.seed) + "".join(f"\n[[object]]\n{each}\n" for each in tables))
    print(f"{len(tables)} tables in {given.out}")


def written(solids: list[Solid], longest_m: float, turn: Rotation) -> str:
    """The table of an object: its solids turned, and scaled to a longest side; the middle one comes first."""
    centres = np.array([solid.centre for solid in solids])
    reach = np.array([np.abs(solid.turn.as_matrix()) @ solid.sides / 2 for solid in solids])
    low, high = (centres - reach).min(axis=0), (centres + reach).max(axis=0)
    scale = longest_m / (high - low).max()
    first = solids[int(np.linalg.norm(centres - (low + high) / 2, axis=1).argmin())]
    lines = []
    for solid in [first, *(solid for solid in solids if solid is not first)]:
        angles_deg = (turn * solid.turn).as_euler("xyz", degrees=True)
        if solid is not first:
            lines.append("[[object.beside]]")
            lines.append(f"offset_m = {axes(turn.apply(solid.centre - first.centre) * scale)}")
        sides = ", ".join(f"{side:.3f}" for side in solid.sides * scale)
        lines += [f'shape = "{solid.shape}"', f"size_m = [{sides}]", f"rotation_deg = {axes(angles_deg)}"]
    return "\n".join(lines)


def axes(values: Point) -> str:
    """Three numbers by axis."""
    return "{ " + ", ".join(f"{name} = {value:.3f}" for name, value in zip("xyz", values, strict=True)) + " }"


def solid_at(shape: str, sides: object, centre: object, turn: Rotation | None = None) -> Solid:
    """A solid, not turned by default."""
    return Solid(shape, np.array(sides, float), np.array(centre, float), turn or Rotation.identity())


def any_solid(rng: Rng, shapes: tuple[str, ...]) -> Solid:
    """A solid of random sides, turned anyhow, at the origin."""
    return solid_at(rng.choice(shapes), rng.uniform(0.2, 1, 3), (0, 0, 0), Rotation.random(rng=rng))


def union(rng: Rng, solids: list[Solid]) -> list[Solid]:
    """Solids, each with its centre in one of those before it."""
    for number, solid in enumerate(solids[1:], 1):
        other = solids[rng.integers(number)]
        solid.centre = other.centre + other.turn.apply(other.sides * rng.uniform(-0.5, 0.5, 3))
    return solids


def stretched(rng: Rng) -> list[Solid]:
    """One primitive of random sides."""
    return [any_solid(rng, PRIMITIVES)]


def apart(rng: Rng) -> list[Solid]:
    """Two solids that do not touch."""
    one, two = any_solid(rng, SOLIDS), any_solid(rng, SOLIDS)
    direction = rng.standard_normal(3)
    two.centre = direction / np.linalg.norm(direction) * rng.uniform(1.6, 3)
    return [one, two]


def boxes(rng: Rng) -> list[Solid]:
    """A union of boxes."""
    return union(rng, [any_solid(rng, ("cube",)) for _ in range(rng.integers(2, 5))])


def balls(rng: Rng) -> list[Solid]:
    """A union of ellipsoids."""
    return union(rng, [any_solid(rng, ("sphere",)) for _ in range(rng.integers(2, 6))])


def mixture(rng: Rng) -> list[Solid]:
    """A union of any primitives."""
    return union(rng, [any_solid(rng, PRIMITIVES) for _ in range(rng.integers(2, 5))])


def rod(shape: str, thick: float, start: Point, end: Point) -> Solid:
    """A box or cylinder from one point to another."""
    along = end - start
    turn = Rotation.align_vectors([along], [(0, 0, 1)])[0]
    return Solid(shape, np.array([thick, thick, np.linalg.norm(along)]), (start + end) / 2, turn)


def tube(rng: Rng) -> list[Solid]:
    """A bent tube with round joints."""
    thick = rng.uniform(0.2, 0.4)
    points = np.cumsum(rng.uniform(-0.6, 0.6, (rng.integers(3, 5), 3)), axis=0)
    rods = [rod("cylinder", thick, *ends) for ends in pairwise(points)]
    return [*rods, *(solid_at("sphere", [thick] * 3, point) for point in points[1:-1])]


def letter(rng: Rng) -> list[Solid]:
    """A letter of bars."""
    width, depth = rng.uniform(0.5, 1.0), rng.uniform(0.4, 1.0)
    bars = []
    for x, z, to_x, to_z in LETTERS[str(rng.choice(list(LETTERS)))]:
        turn = Rotation.from_euler("y", -np.arctan2(to_z - z, to_x - x))
        sides = (np.hypot(to_x - x, to_z - z) + width, depth * rng.uniform(0.8, 1), width)
        bars.append(solid_at("cube", sides, ((x + to_x) / 2, 0, (z + to_z) / 2), turn))
    return bars


def furniture(rng: Rng) -> list[Solid]:
    """A table, a stool or a chair without arms."""
    width, depth, height = rng.uniform(0.4, 1.0, 3)
    thick = rng.uniform(0.08, 0.15)
    solids = [solid_at("cube", (width, depth, thick), (0, 0, height))]
    for x in (-1, 1):
        for y in (-1, 1):
            foot = (x * (width / 2 - thick), y * (depth / 2 - thick), height / 2)
            solids.append(solid_at("cube", (thick, thick, height), foot))
    if rng.random() < 0.5:
        solids.append(solid_at("cube", (0.95 * width, thick, height), (0, depth / 2 - thick, 1.5 * height)))
    return solids


def upright_box(rng: Rng) -> list[Solid]:
    """A box that is as high as a person."""
    return [solid_at("cube", (rng.uniform(0.2, 0.4), rng.uniform(0.35, 0.6), 1.7), (0, 0, 0))]


def person(rng: Rng) -> list[Solid]:
    """A standing person: trunk, head, legs and arms; metres."""
    solids = [solid_at("sphere", (0.26, 0.4, 0.7), (0, 0, 1.15)), solid_at("sphere", [0.24] * 3, (0, 0, 1.6))]
    for side in (-1, 1):
        foot = np.array([rng.uniform(-0.2, 0.2), side * rng.uniform(0.08, 0.25), 0])
        hand = np.array([rng.uniform(-0.1, 0.5), side * rng.uniform(0.2, 0.7), rng.uniform(0.8, 1.6)])
        solids.append(rod("cylinder", 0.16, np.array([0, 0.1 * side, 0.9]), foot))
        solids.append(rod("cylinder", 0.1, np.array([0, 0.2 * side, 1.4]), hand))
    return solids


if __name__ == "__main__":
    main()
