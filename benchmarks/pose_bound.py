"""How well a hidden object of known shape could be located: the Cramér-Rao bound of its pose.

For each primitive, the hidden light is rendered at a pose and at poses that differ by a small step along and
about each axis. With white noise of standard deviation sigma in each component of the phasors (relative to
the amplitude of the direct light at the first frequency), no unbiased estimate of the pose has a smaller
covariance than sigma² (J' J)^-1, where J is the derivative of hidden / direct light. Sigma is 1 % of the
hidden light's root mean square; the bounds grow in proportion to it. Wall and phase offsets may be unknowns
too, as for channels that calibrate themselves: their derivatives are further columns of J.

Rotations that do not change the light are left out. The table has, for position and for rotation, the
standard deviation along the best and the worst axis. The error column is how much the derivatives of two sets
of random points on the surface differ.

Run:

    .venv/bin/python benchmarks/pose_bound.py
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from seven_scenes import made_datasets

from itof import TransientLayout, phase_per_metre, pixel_rays
from model.data.corner import wall_view
from render.backend import select_variant
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.scene_loading import load_scene
from scenegen import Dataset
from scenegen.shapes import PRIMITIVES

HZ = (20e6, 50e6, 60e6)
CENTRE_M = np.array([1.15, 0.9, 1.6])  # the middle of the preset paper's range
TURNED = Rotation.from_euler("xyz", [25, -35, 50], degrees=True)
STEP_M, STEP_RAD = 0.01, 0.04
SIGMA = 0.01  # of the hidden light's root mean square
CERTAIN = 3.0  # a rotation changes the light if its derivative is so many times the error of the derivatives


def main() -> None:
    """Print a line for each primitive."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--size", default="40x30", help="image size, default 40x30")
    arguments.add_argument("--lights", type=int, default=16384, help="points on the surface, default 16384")
    given = arguments.parse_args()
    width, height = map(int, given.size.split("x"))
    variant = select_variant()
    print(
        f"noise 1 % of the hidden light in each component, {width} x {height} pixels, {given.lights} lights"
    )
    print("| shape | position, mm | rotation, degrees | the same, wall and phases unknown | | error of J |")
    print("|---|---|---|---|---|---|")
    for shape in PRIMITIVES:
        with TemporaryDirectory() as folder:
            datasets = made_datasets(
                {Path(folder) / str(i): _preset(shape, *pose) for i, pose in enumerate(_poses())}
            )
            derivatives, hidden = [], np.zeros(0)
            for seed in (1, 2):
                method = ManyLight(ManyLightOptions(lights=given.lights), variant)
                view = View(TransientLayout(width, height, 2000, 0.01, 0.0), HZ, 3, seed)
                images = [_relative(method, view, dataset) for dataset in datasets]
                hidden = images[0]
                derivatives.append(_derivative(images))
            noise = SIGMA * np.sqrt((hidden**2).mean())
            jacobian = np.mean(derivatives, axis=0)  # (values, 6)
            nuisance = _wall_and_phases(datasets[0], width, height)
            spread = (derivatives[1] - derivatives[0]) / 2  # the error of the mean
            cells = [*_bounds(jacobian, spread, noise), *_bounds(jacobian, spread, noise, nuisance)]
            error = np.linalg.norm(derivatives[1] - derivatives[0]) / np.sqrt(2) / np.linalg.norm(jacobian)
            print(f"| {shape.replace('_', ' ')} | {' | '.join(cells)} | {100 * error:.1f} % |", flush=True)


def _poses() -> Iterator[tuple[NDArray[np.float64], Rotation]]:
    """The pose, then a step forward and one back along and about each world axis."""
    yield CENTRE_M, TURNED
    for axis in np.eye(3):
        for sign in (1, -1):
            yield CENTRE_M + sign * STEP_M * axis, TURNED
    for axis in np.eye(3):
        for sign in (1, -1):
            yield CENTRE_M, Rotation.from_rotvec(sign * STEP_RAD * axis) * TURNED


def _preset(shape: str, centre_m: NDArray[np.float64], turned: Rotation) -> dict[str, object]:
    place = dict(zip("xyz", centre_m.tolist(), strict=True))
    angles = dict(zip("xyz", turned.as_euler("xyz", degrees=True).tolist(), strict=True))
    return {
        "dataset": {"count": 1},
        "hidden_object": {
            "shapes": [shape],
            "composite_fraction": 0.0,
            "location_m": {name: [value, value] for name, value in place.items()},
            "rotation_deg": {name: [value, value] for name, value in angles.items()},
        },
        "relay_wall": {"roughness": [0.6]},
    }


def _relative(method: ManyLight, view: View, dataset: Dataset) -> NDArray[np.float64]:
    """(values,) components of hidden / direct light, turned by the phase of the direct light."""
    image = method.expose(load_scene(dataset, dataset.ids()[0]), view).phasors()
    direct = image.total - image.hidden
    turned = image.hidden * np.conj(direct) / np.abs(direct) / np.abs(direct[..., :1])  # (H, W, F)
    return np.stack([turned.real, turned.imag]).ravel()


def _derivative(images: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(values, 6) central differences along and about the axes, per metre and per radian."""
    steps = [STEP_M] * 3 + [STEP_RAD] * 3
    pairs = zip(images[1::2], images[2::2], steps, strict=True)
    return np.stack([(forward - back) / (2 * step) for forward, back, step in pairs], axis=1)


def _wall_and_phases(dataset: Dataset, width: int, height: int) -> NDArray[np.float64]:
    """(values, 3 + F) derivatives by the plane of the wall and by a phase offset of each frequency."""
    view = wall_view(dataset)
    wall = view.expected_wall(view.direct_phasors(width, height, HZ), HZ)
    rays = pixel_rays(width, height, view.horizontal_fov_deg)  # (H, W, 3)
    slope = 2 * phase_per_metre(HZ)  # (F,)
    amplitude = np.abs(wall.direct) / np.abs(wall.direct[..., :1])  # (H, W, F)
    columns = []
    for axis in range(3):
        moved_m = -(wall.radial_depth_m**2) * rays[..., axis]  # (H, W)
        columns.append(moved_m[..., None] * slope * amplitude)
    columns += [amplitude * (np.arange(len(HZ)) == place) for place in range(len(HZ))]
    return np.stack([np.stack([np.zeros_like(each), each]).ravel() for each in columns], axis=1)


def _bounds(
    jacobian: NDArray[np.float64],
    spread: NDArray[np.float64],
    noise: float,
    nuisance: NDArray[np.float64] | None = None,
) -> tuple[str, str]:
    """Bounds of position and rotation as text, best and worst axis; `spread` is the error of `jacobian`."""
    if nuisance is not None:
        basis = np.linalg.qr(nuisance)[0]
        jacobian, spread = (each - basis @ (basis.T @ each) for each in (jacobian, spread))
    moves, turns = jacobian[:, :3], jacobian[:, 3:]
    axes, sizes, _ = np.linalg.svd(turns.T, full_matrices=False)
    certain = sizes > CERTAIN * np.linalg.norm(spread[:, 3:] @ axes, axis=0)
    seen = turns @ axes[:, certain]  # (values, up to 3)
    both = np.concatenate([moves, seen], axis=1)
    covariance = noise**2 * np.linalg.inv(both.T @ both)
    metres = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]))
    radians = np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:]))
    position = f"{1e3 * metres[0]:.2f} to {1e3 * metres[-1]:.2f}"
    if not len(radians):
        return position, "-"
    low, high = np.degrees(radians[[0, -1]])
    return position, f"{low:.2f} to {high:.2f}" + (f" ({len(radians)} axes)" if len(radians) < 3 else "")


if __name__ == "__main__":
    main()
