"""How often the true wall lies within the bounds that a fit of an image states, over all cameras.

Each case is an empty corner: a plane 0.7 to 3 m away, turned by up to 50 degrees, a field of view of 45 to 80
degrees, one to three frequencies, a camera of data/sensors with its waves, scattering and noise, and phase
offsets as large as the fit takes them to be. The wall is within the bounds if its distance along the pixels'
rays differs by less than two standard deviations (root mean square of each). Walls beyond the unambiguous
range are left out. Run:

    .venv/bin/python benchmarks/wall_coverage.py --cases 500
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np

from itof.light import OFFSET_STD_RAD
from itof.sensor.binned import BinnedCamera
from itof.sensor.cameras import load_sensor
from itof.unwrapping import combined_range_m
from itof.wall.expected_wall import ExpectedWall, angle_deg
from itof.wall.unknown_wall import see_wall

SENSORS = ("ideal", "opt8241", "mlx75027", "measured-waves", "calibrated", "sixteen-steps", "cheap")
FREQUENCIES_HZ = ((20e6, 50e6, 60e6), (40e6, 70e6), (20e6, 100e6), (20e6,), (20e6, 50e6, 60e6))
COLUMNS = ("off by, cm", "stated, cm", "turned by, °", "stated, °")
WIDTH, HEIGHT = 80, 60
FRAMES = 20  # averaged


@dataclass(frozen=True)
class Case:
    """What is drawn: the wall, and the image (H, W, F) that a camera makes of it."""

    sensor: str
    plane_per_m: np.ndarray
    image: np.ndarray
    frequencies_hz: tuple[float, ...]
    fov_deg: float
    offset_std_rad: float


def main() -> None:
    """Print coverage and medians for each camera."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in SENSORS}
    for number in range(given.cases):
        case = drawn(SENSORS[number % len(SENSORS)], np.random.default_rng([given.seed, number]))
        found[case.sensor].append(judged(case))
    print(f"| camera | cases | within | {' | '.join(COLUMNS)} |\n|---{'|---' * 6}|")
    every = [row for rows in found.values() for row in rows]
    for name, rows in (*found.items(), ("all", every)):
        off, std, tilt, tilt_std = np.array(rows).T
        numbers = (100 * np.median(off), 100 * np.median(std), np.median(tilt), np.median(tilt_std))
        within = f"{100 * np.mean(off <= 2 * std):.1f} %"
        print(f"| {name} | {len(rows)} | {within} | {' | '.join(f'{each:.2g}' for each in numbers)} |")


def drawn(sensor: str, rng: np.random.Generator) -> Case:
    """A wall that fills most of the image, within the range of the frequencies."""
    frequencies_hz = FREQUENCIES_HZ[rng.integers(len(FREQUENCIES_HZ))]
    while True:
        fov_deg, away_m = rng.uniform(45, 80), rng.uniform(0.7, 3.0)
        tilt, about = np.radians(rng.uniform(0, 50)), rng.uniform(0, 2 * np.pi)
        sideways = np.sin(tilt) * np.array([np.cos(about), np.sin(about) / 2])
        normal = np.array([*sideways, np.cos(tilt)])
        wall = ExpectedWall.of_plane(
            normal / np.linalg.norm(normal) / away_m, WIDTH, HEIGHT, frequencies_hz, fov_deg
        )
        if wall.meets.all() and wall.radial_depth_m.max() < combined_range_m(frequencies_hz):
            break
    settings = replace(load_sensor(sensor), horizontal_fov_deg=fov_deg)
    known = OFFSET_STD_RAD * (0.3, 1.0)[rng.integers(2)]
    offsets = known * rng.standard_normal(len(frequencies_hz))
    camera = BinnedCamera(replace(settings, frames=FRAMES), frequencies_hz, WIDTH, HEIGHT)
    re, im = rng.standard_normal((2, *wall.direct.shape))
    image = camera.mean(wall.direct * np.exp(1j * offsets)) + camera.spread(wall.direct) * (re + 1j * im)
    return Case(sensor, wall.plane_per_m, image, frequencies_hz, fov_deg, known)


def judged(case: Case) -> tuple[float, ...]:
    """Error and standard deviation of the distance, metres, and of the angle, degrees."""
    seen = see_wall(case.image, case.frequencies_hz, case.fov_deg, case.offset_std_rad)
    if seen is None or seen[1] or not seen[0].shows_wall:
        return np.inf, 0.0, 180.0, 0.0
    fit = seen[0]
    rays = fit.wall.rays.reshape(-1, 3)
    true, inverse = rays @ case.plane_per_m, rays @ fit.plane_per_m
    ahead = inverse > 1e-3
    off = np.sqrt(np.mean((1 / true[ahead] - 1 / inverse[ahead]) ** 2))
    tangent = rays[ahead] / inverse[ahead, None] ** 2
    std = np.sqrt(np.mean(np.einsum("pi,ij,pj->p", tangent, fit.plane_covariance, tangent)))
    return float(off), float(std), angle_deg(case.plane_per_m, fit.plane_per_m), fit.tilt_std_deg


if __name__ == "__main__":
    main()
