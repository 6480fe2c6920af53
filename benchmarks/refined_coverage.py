"""How often the truth lies within the standard deviations that a refinement states.

Of accepted fits with the right shape, of single solids. Places and rotations are counted along the axes of
the world, extents in the solid's own axes, relative; rotations only of shapes without an axis of symmetry. Of
a depth map, it is the mean absolute error over the expected one. `refined` is the folder that `night-eval
refine` has written, also of one that goes on. Run:

    .venv/bin/python benchmarks/refined_coverage.py refined --of many
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter
from scipy.spatial.transform import Rotation

from model.prediction.explanation import Explanation, FoundSolid
from model.refinement.refined_result import RefinedScene
from model.refinement.unknowns import stretches
from model.refinement.work import SCENES_FOLDER
from scenegen import open_dataset
from scenegen.pose import rotation_matrix
from scenegen.scene import HiddenObject

Floats = NDArray[np.float64]
WITHIN = 2.0  # standard deviations
ROUND = ("sphere", "cylinder", "cone")
TURNS = {
    "cube": Rotation.create_group("O"),
    "parallelepiped": Rotation.create_group("O"),
    "concave_plane": Rotation.from_rotvec([[0, 0, 0], [np.pi, 0, 0]]),
}


def main() -> None:
    """Print a row for each quantity."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("refined", type=Path, help="folder of the refinement")
    parser.add_argument("--of", type=Path, required=True, help="its dataset")
    given = parser.parse_args()
    dataset = open_dataset(given.of)
    files = sorted((given.refined / SCENES_FOLDER).glob("*.json"))
    results = [TypeAdapter(RefinedScene).validate_json(file.read_text()) for file in files]
    pairs = [(result, dataset.scene(result.scene).hidden_objects) for result in results]
    accepted = [(result, parts[0]) for result, parts in pairs if len(parts) == 1 and result.accepted]
    right = [(result, solid) for result, solid in accepted if shapes(result.found) == [solid.shape]]
    print(
        f"{sum(len(parts) == 1 for _, parts in pairs)} single solids, {len(accepted)} accepted, "
        f"{len(accepted) - len(right)} of these with a wrong shape\n"
    )
    values: dict[str, list[float]] = {"place": [], "size": [], "rotation": [], "depth map": []}
    for result, solid in right:
        for name, value in errors(result.found.solids[0], solid):
            values[name].append(value)
        values["depth map"].append(result.refined.depth_mae_m / result.found.expected_mae_m)
    print(f"| | values | within {WITHIN:g} stated | root mean square of error / stated | largest |")
    print("|---|---|---|---|---|")
    for name, found in values.items():
        if found:
            print(line(name, np.abs(found)))


def shapes(found: Explanation | None) -> list[str]:
    """Of the solids that were found."""
    return [] if found is None else [solid.shape for solid in found.solids]


def line(name: str, over: Floats) -> str:
    """A row of the table, of errors over stated standard deviations."""
    within = over <= WITHIN
    return (
        f"| {name} | {len(over)} | {within.mean():.0%} | {np.sqrt((over**2).mean()):.2f} | {over.max():.1f} |"
    )


def errors(found: FoundSolid, true: HiddenObject) -> Iterator[tuple[str, float]]:
    """Each quantity and its error over the stated standard deviation."""
    away_m = np.subtract(found.location_m, true.location_m)
    yield from (("place", each) for each in away_m / found.location_std_m)
    turn = nearest(found, true)
    size_m = np.abs(turn.T @ true.size_m)  # along the axes of the found solid
    if any(found.size_std_m):
        over = np.log(np.divide(found.size_m, size_m)) / np.divide(found.size_std_m, found.size_m)
        yield from (("size", over[axis]) for axis in stretches(found.shape).argmax(axis=1))
    if found.shape not in ROUND:
        turned = rotation_matrix(found.rotation_deg) @ (rotation_matrix(true.rotation_deg) @ turn).T
        by_deg = np.degrees(Rotation.from_matrix(turned).as_rotvec())
        yield from (("rotation", each) for each in by_deg / found.rotation_std_deg)


def nearest(found: FoundSolid, true: HiddenObject) -> Floats:
    """(3, 3) of the turns in own axes that leave the true solid as it is, the nearest to the found one."""
    turns = TURNS.get(found.shape, Rotation.identity(1)).as_matrix()
    own = rotation_matrix(true.rotation_deg).T @ rotation_matrix(found.rotation_deg)
    if found.shape in ROUND:
        return turns[0]
    best: Floats = turns[int(np.einsum("nij,ij->n", turns, own).argmax())]
    return best


if __name__ == "__main__":
    main()
