"""Which measurements are answered without a warning: good ones of new scenes, and ten kinds of foreign ones.

Of each scene one good image and one of its empty corner are taken, with one of four noises, or by one of the
given cameras in turn. Counts of what `capture check` and `predict` say, findings by their codes (those that
refuse with an exclamation mark), and quantiles of the share of the hidden light that the network's answers
explain. *Right* counts the good images whose warning of `predict` is right: the answer has no smaller MAE
than "no object"; or noise is said to hide the hidden light, and the true light of the scene, in the network's
channels, is below what the noise hides. With `--out`, a run that was stopped goes on.
Run:

    .venv/bin/python benchmarks/foreign_measurements.py night-80x60 judge --count 300 --foreign --seed 47
    .venv/bin/python benchmarks/foreign_measurements.py any-corner judge-any-corner --count 300
    .venv/bin/python benchmarks/foreign_measurements.py night-80x60-camera judge --sensor calibrated mlx75027
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from itof import phase
from itof.arrays import Phasors
from itof.capture.image_check import check_image
from itof.light import phase_per_metre
from itof.sensor.camera import Camera
from itof.sensor.cameras import load_sensor
from itof.unwrapping import unwrap_depth
from itof.wall.plausibility import check_measurement
from model.prediction.predictor import Predictor, load
from model.settings.fresh import FreshScenes
from render.batch.light import BatchedLight
from scenegen import load_preset

AT_ONCE = 20
NOISES = (0.0, 3e-4, 1e-3, 3e-3)  # of a pixel's amplitude
QUANTILES = (0.01, 0.05, 0.5)
# Of a scene, of another by the same camera, and of the empty corner; and the true depth map.
Images = tuple[Phasors, Phasors, Phasors, NDArray[np.floating]]
Row = dict[str, Any]  # what was said about one image


def main() -> None:
    """Print a row for each kind of measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("preset", help="of the scenes")
    parser.add_argument("--count", type=int, default=100, help="scenes, default 100")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sensor", nargs="*", help="cameras of data/sensors, with captures of the corner")
    parser.add_argument("--foreign", action="store_true", help="also ten kinds of foreign measurements")
    parser.add_argument("--out", type=Path, help="file of the rows so far")
    given = parser.parse_args()
    predictor = load(given.run, "cpu")
    lines = given.out.read_text().splitlines() if given.out and given.out.exists() else []
    rows: list[Row] = [json.loads(line) for line in lines]
    done = {row["scene"] for row in rows}
    for scene, images, fov_deg in pairs(predictor, given.preset, given.count, given.seed, done):
        new = [{"scene": scene} | row for row in of_scene(predictor, given, scene, images, fov_deg)]
        rows += new
        if given.out:
            with given.out.open("a") as file:
                file.writelines(json.dumps(row) + "\n" for row in new)
    head = "| measurement | images | check: warned, refused | predict: warned, refused | right "
    print(
        head
        + "| with an object | explained: 1 %, 5 %, median | findings |\n|---|---|---|---|---|---|---|---|"
    )
    for kind in dict.fromkeys(row["kind"] for row in rows):
        tell(kind, [row for row in rows if row["kind"] == kind and row["scene"] < given.count])


def of_scene(
    predictor: Predictor,
    given: argparse.Namespace,
    scene: int,
    images: Images,
    fov_deg: float,
) -> Iterator[Row]:
    """What is said about the images of a scene: good, empty, and foreign."""
    z, other, empty, depth_m = images
    rng = np.random.default_rng([given.seed, scene])
    frequencies_hz = predictor.config.inputs.frequencies_hz
    for name, image, true_m in (("good", z, depth_m), ("empty", empty, np.zeros_like(depth_m))):
        if given.sensor:
            sensor = given.sensor[scene % len(given.sensor)]
            camera = Camera(load_sensor(sensor), frequencies_hz)
            seen, reference = (camera.capture(each, rng).phasor for each in (image, empty))
            row = said(predictor, seen, fov_deg, reference, true=(image, empty, true_m))
            yield {"kind": f"{name}, {sensor}"} | row
        else:
            noise = NOISES[scene % len(NOISES)]
            row = said(predictor, grainy(image, noise, rng), fov_deg, true=(image, None, true_m))
            yield {"kind": f"{name}, noise {noise:g}"} | row
    if given.foreign:
        for kind, spoilt in foreign(z, other, frequencies_hz).items():
            yield {"kind": kind} | said(predictor, spoilt, fov_deg)


def pairs(
    predictor: Predictor, preset: str, count: int, seed: int, done: set[int]
) -> Iterator[tuple[int, Images, float]]:
    """Scenes that are not done: number, images, and field of view."""
    config, stream = predictor.config, FreshScenes(load_preset(preset)).with_seed(seed)
    size = (config.image_width, config.image_height)
    light = BatchedLight(config.inputs.frequencies_hz, *size, error=0.02)
    for start in range(0, count, AT_ONCE):
        if all(each in done for each in range(start, start + AT_ONCE)):
            continue
        some = [stream.scene(index, {}) for index in range(start, start + AT_ONCE)]
        moved = [
            replace(other, camera=one.camera, emitter=one.emitter)
            for one, other in zip(some, some[1:] + some[:1], strict=True)
        ]
        images, others = light.images(some), light.images(moved)
        for place, scene in enumerate(some):
            if start + place in done or start + place >= count:
                continue
            direct = images.direct[place].astype(np.complex128)
            other = others.direct[place].astype(np.complex128) + others.hidden[place]
            fov_deg = scene.camera.horizontal_fov_deg
            depth_m = images.radial_depth_m[place]
            yield start + place, (direct + images.hidden[place], other, direct, depth_m), fov_deg


def grainy(z: Phasors, noise: float, rng: np.random.Generator) -> Phasors:
    """An image with noise in proportion to each pixel's amplitude."""
    re, im = rng.standard_normal((2, *z.shape)) / np.sqrt(2)
    return z * (1 + noise * (re + 1j * im))


def foreign(z: Phasors, other: Phasors, frequencies_hz: tuple[float, ...]) -> dict[str, Phasors]:
    """An image that is no measurement of a corner, by kind."""
    height, width = z.shape[:2]
    step = np.abs(z).max() / 127
    depth_m = unwrap_depth(phase(z), frequencies_hz)
    return {
        "first frequency of another scene": np.concatenate([other[..., :1], z[..., 1:]], axis=-1),
        "last frequency of another scene": np.concatenate([z[..., :-1], other[..., -1:]], axis=-1),
        "lower half shifted": np.concatenate([z[: height // 2], np.roll(z[height // 2 :], 1, axis=1)]),
        "rolled by a column": np.roll(z, 1, axis=1),
        "rolled by three rows": np.roll(z, 3, axis=0),
        "one row repeated": np.repeat(z[height // 2][None], height, axis=0),
        "rows exchanged in pairs": z.reshape(-1, 2, *z.shape[1:])[:, ::-1].reshape(z.shape),
        "eight bits": step * (np.round(z.real / step) + 1j * np.round(z.imag / step)),
        "left half of another scene": np.concatenate([other[:, : width // 2], z[:, width // 2 :]], axis=1),
        "one depth for all": np.abs(z)
        * np.exp(1j * depth_m[..., None] * phase_per_metre(frequencies_hz) * 2),
    }


def said(
    predictor: Predictor,
    z: Phasors,
    fov_deg: float,
    reference: Phasors | None = None,
    true: tuple[Phasors, Phasors | None, NDArray[np.floating]] | None = None,
) -> Row:
    """What `capture check` and `predict` say about an image. `true`: both without noise, and the depth."""
    inputs, found = predictor.config.inputs, []
    seen = predictor.at(predictor.config.geometry.with_fov(fov_deg))
    own, shift_m = inputs.self_calibrates, inputs.largest_shift_m
    checked = check_measurement(z, seen.wall, reference, self_calibrated=own, known_shift_m=shift_m)
    found += checked.findings
    row: Row = {"object": False, "share": None, "right": False}
    if not any(each.refused for each in found):
        prediction = seen.predict(z[None], reference, rescale=True)
        (light,) = seen.explained_light(z[None], prediction, reference, thorough=True)
        row["object"] = bool(prediction.mask.any())
        if light is not None:
            told = list(light.findings(shows_object=row["object"]))
            found += told
            row["share"] = light.share
            if told and true is not None:
                *images, true_m = true
                hidden = seen.hidden_light(*images) if light.share is None else None
                is_hidden = hidden is not None and np.sqrt((hidden**2).mean()) < light.hideable
                off_m = np.abs(prediction.radial_depth_m[0] * prediction.mask[0] - true_m).mean()
                row["right"] = bool(is_hidden or (row["object"] and off_m >= true_m.mean()))
    first = check_image(z, inputs.frequencies_hz, fov_deg).findings
    codes = ([f"{each.code}{'!' * each.refused}" for each in some] for some in (first, found))
    return row | dict(zip(("check", "predict"), codes, strict=True))


def tell(kind: str, rows: list[Row]) -> None:
    """Print a row about images of a kind."""
    counts = []
    for command in ("check", "predict"):
        warned = sum(bool(row[command]) for row in rows)
        refused = sum(any(code.endswith("!") for code in row[command]) for row in rows)
        counts.append(f"{warned}, {refused}")
    shares = [row["share"] for row in rows if row["share"] is not None]
    share = ", ".join(f"{each:.2f}" for each in np.quantile(shares, QUANTILES)) if shares else ""
    right, objects = (sum(row[name] for row in rows) for name in ("right", "object"))
    codes = Counter(
        f"{command} {code}" for row in rows for command in ("check", "predict") for code in row[command]
    )
    words = ", ".join(f"{code} {count}" for code, count in codes.items())
    cells = (kind, len(rows), *counts, right, objects, share, words)
    print("| " + " | ".join(map(str, cells)) + " |")


if __name__ == "__main__":
    main()
