"""Which measurements are answered without a warning: good ones of new scenes, and ten kinds of foreign ones.

Counts of what `capture check` and `predict` say, findings by their codes (those that refuse with an
exclamation mark), and quantiles of the share of the hidden light that the network's answers explain. Run:

    .venv/bin/python benchmarks/foreign_measurements.py night-80x60 judge --count 300 --foreign
    .venv/bin/python benchmarks/foreign_measurements.py any-corner-80x60 judge-any-corner --count 1000
    .venv/bin/python benchmarks/foreign_measurements.py night-80x60-camera judge --sensor calibrated
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

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
Images = list[tuple[Phasors, Phasors, float]]  # image, that of the empty corner, and field of view in degrees


def main() -> None:
    """Print a row for each kind of measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("preset", help="of the scenes")
    parser.add_argument("--count", type=int, default=100, help="scenes, default 100")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sensor", help="camera of data/sensors, with a capture of the empty corner")
    parser.add_argument("--foreign", action="store_true", help="also ten kinds of foreign measurements")
    given = parser.parse_args()
    predictor, rng = load(given.run, "cpu"), np.random.default_rng(given.seed)
    head = "| measurement | images | check: warned, refused | predict: warned, refused | with an object "
    print(head + "| explained: 1 %, 5 %, median | findings |\n|---|---|---|---|---|---|---|", flush=True)
    scenes = list(pairs(predictor, given.preset, given.count, given.seed))
    good = [(z, empty, fov_deg) for z, _, empty, fov_deg in scenes]
    if given.sensor:
        camera = Camera(load_sensor(given.sensor), predictor.config.inputs.frequencies_hz)
        seen = [(*(camera.capture(each, rng).phasor for each in one[:2]), one[2]) for one in good]
        tell(predictor, f"good, {given.sensor}", seen, captured=True)
        return
    for noise in NOISES:
        for name, images in (("good", good), ("empty", [(empty, empty, fov) for _, empty, fov in good])):
            spoilt = [(grainy(z, noise, rng), empty, fov_deg) for z, empty, fov_deg in images]
            tell(predictor, f"{name}, noise {noise:g}", spoilt)
    if given.foreign:
        kinds = [foreign(z, other, predictor.config.inputs.frequencies_hz) for z, other, _, _ in scenes]
        for name in kinds[0]:
            spoilt = [(kind[name], one[1], one[2]) for kind, one in zip(kinds, good, strict=True)]
            tell(predictor, name, spoilt)


def pairs(
    predictor: Predictor, preset: str, count: int, seed: int
) -> Iterator[tuple[Phasors, Phasors, Phasors, float]]:
    """Images of new scenes, of others by the same camera, of the empty corner; and fields of view."""
    config, stream = predictor.config, FreshScenes(load_preset(preset)).with_seed(seed)
    size = (config.image_width, config.image_height)
    light = BatchedLight(config.inputs.frequencies_hz, *size, error=0.02)
    for start in range(0, count, AT_ONCE):
        some = [stream.scene(index, {}) for index in range(start, min(start + AT_ONCE, count))]
        moved = [
            replace(other, camera=one.camera, emitter=one.emitter)
            for one, other in zip(some, some[1:] + some[:1], strict=True)
        ]
        images, others = light.images(some), light.images(moved)
        for place, scene in enumerate(some):
            direct = images.direct[place].astype(np.complex128)
            other = others.direct[place].astype(np.complex128) + others.hidden[place]
            yield direct + images.hidden[place], other, direct, scene.camera.horizontal_fov_deg


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


def tell(predictor: Predictor, name: str, images: Images, *, captured: bool = False) -> None:
    """Print a row about images."""
    inputs, codes = predictor.config.inputs, Counter[str]()
    shares, objects, told = [], 0, np.zeros((2, 2), int)  # by `capture check` and `predict`: warned, refused
    for z, empty, fov_deg in images:
        seen = predictor.at(predictor.config.geometry.with_fov(fov_deg))
        reference = empty if captured else None
        own, shift_m = inputs.self_calibrates, inputs.largest_shift_m
        checked = check_measurement(z, seen.wall, reference, self_calibrated=own, known_shift_m=shift_m)
        found = list(checked.findings)
        if not any(each.refused for each in found):
            prediction = seen.predict(z[None], reference, rescale=True)
            (light,) = seen.explained_light(z[None], prediction, reference, thorough=True)
            objects += bool(prediction.mask.any())
            if light is not None:
                found += light.findings(shows_object=bool(prediction.mask.any()))
                shares += [] if light.share is None else [light.share]
        for place, findings in enumerate((check_image(z, inputs.frequencies_hz, fov_deg).findings, found)):
            told[place] += bool(findings), any(each.refused for each in findings)
            codes.update({f"{each.code}{'!' * each.refused}" for each in findings})
    share = ", ".join(f"{each:.2f}" for each in np.quantile(shares, QUANTILES)) if shares else ""
    check, predict = (f"{warned}, {refused}" for warned, refused in told)
    kinds = ", ".join(f"{code} {count}" for code, count in codes.items())
    print(f"| {name} | {len(images)} | {check} | {predict} | {objects} | {share} | {kinds} |", flush=True)


if __name__ == "__main__":
    main()
