"""Refinement by rendering behind a modelled camera, over the exposure.

The camera of --sensor is in front of the first test scenes with a single solid. It has contrasts and waves of
its own; the measurement is taken over a capture of the empty corner by the same camera, with
eight times the exposures. The solids, the corner and the depth map to start from are as in
`night-eval refine`. Where a fit is not accepted, the network's depth map counts.

Run:

    .venv/bin/python benchmarks/refined_exposures.py night-80x60-camera new80 --scenes 12
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from refinement_limits import HEAD, Judged, judgement, single_solids, sizes_of, table

from itof import read_image
from itof.sensor.cameras import load_sensor
from itof.sensor.random_camera import random_camera
from itof.sensor.scene_camera import SceneCamera
from itof.sensor.settings import SensorSettings
from itof.wall.empty_corner import captured_wall
from model.data.corner import wall_view
from model.data.shards import Shards, open_shards
from model.prediction.predictor import Predictor, load
from model.refinement.family import Family
from model.refinement.light.corner_light import CornerLight, known_corner
from model.refinement.refining import refined
from scenegen import MEASUREMENT_FILE, Dataset, open_dataset

CORNER = 8  # exposures of the empty corner for each of the measurement


def main() -> None:
    """Refine the scenes at each exposure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", help="run folder, or name of a network that comes with NIGHT")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensor", default="sixteen-steps", help="name in data/sensors or TOML file")
    parser.add_argument("--scenes", type=int, default=12, help="test scenes with one solid, default 12")
    parser.add_argument("--exposures", type=int, nargs="+", default=[1, 10, 100])
    parser.add_argument("--no-drift", action="store_true", help="phases that stay between the two captures")
    parser.add_argument("--largest-misfit", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=0, help="of the camera and of its noise")
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    shards, predictor = open_shards(dataset), load(given.run)
    sensor = random_camera(load_sensor(given.sensor), np.random.default_rng([given.seed, 1]))
    if given.no_drift:
        sensor = replace(sensor, phase_drift_rad=0.0)
    rows = single_solids(dataset, shards, given.scenes)
    print(f"{len(rows)} scenes\n\n{HEAD}")
    for count in given.exposures:
        exposed = replace(sensor, frames=sensor.frames * count)
        found = [
            judged(predictor, dataset, shards, exposed, row, given.largest_misfit, given.seed) for row in rows
        ]
        camera = SceneCamera(exposed, predictor.config.inputs.frequencies_hz, 1, 1)
        print(table(f"{1e3 * camera.light_s:.0f} ms", found), flush=True)


def judged(
    predictor: Predictor,
    dataset: Dataset,
    shards: Shards,
    sensor: SensorSettings,
    row: int,
    largest_misfit: float,
    seed: int,
) -> Judged:
    """A scene as the camera measures it."""
    block, (scene,) = shards.read([row]), shards.ids([row])
    inputs = predictor.config.inputs
    image = read_image(dataset.render_folder(scene) / MEASUREMENT_FILE)
    parts = [image.phasors(part) for part in ("itof", "direct", "hidden")]
    phasor, direct, hidden = (each[..., inputs.places(found)] for each, found in parts)
    height, width, _ = phasor.shape
    camera = SceneCamera(sensor, inputs.frequencies_hz, width, height, CORNER * sensor.frames)
    seen = camera.measure(phasor, direct, hidden, np.random.default_rng([seed, 2, row, sensor.frames]))
    corner = np.asarray(seen.corner)
    view = wall_view(dataset)
    prediction = predictor.at(view).predict(seen.phasor, corner, rescale=True)
    computed = view.direct_phasors(width, height, inputs.frequencies_hz)
    wall = captured_wall(corner, view.expected_wall(computed, inputs.frequencies_hz))
    corner, light = known_corner(dataset.scene(dataset.ids()[0])), CornerLight(inputs.frequencies_hz)
    expected_m, family = predictor.expected_mae_m(prediction), Family(sizes_of(dataset))
    found = refined(seen.phasor, prediction, expected_m, wall, corner, light, family, seed=row)
    accepted = found is not None and found.is_right(expected_m, largest_misfit=largest_misfit)
    return judgement(block, prediction, found.depth_map if found and accepted else prediction, accepted)


if __name__ == "__main__":
    main()
