"""What a room that reflects does to a network, without and with a capture of the empty corner.

New scenes at the network's size, in a black room and in rooms of two reflectances. The capture is the
`reference` of a prediction. Run:

    .venv/bin/python benchmarks/reflecting_rooms.py night-80x60 judge --count 40
    .venv/bin/python benchmarks/reflecting_rooms.py any-corner judge-any-corner --count 40

Median ratio of the room's light to the hidden light at the first frequency, how many predictions have a
finding, and the errors of the network.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.linalg import norm

from itof import TransientLayout
from itof.arrays import Phasors
from itof.metrics import image_metrics, no_object_metrics, summarise, summary_cells
from model.prediction.predictor import Predictor, load
from render.backend import select_variant
from render.batch.light import SceneLight
from render.batch.scene_lights import SceneLights
from render.options import ManyLightOptions
from render.room_layer import room_layer
from render.transport.many_light import ManyLight
from render.transport.method import View
from scenegen import Preset, Scene, load_preset
from scenegen.geometry_check import refusal
from scenegen.making.blender import BlenderMaker
from scenegen.possible_scenes import sample_valid_scene
from scenegen.preset import RoomSettings
from scenegen.sampling import room_of, walls_of
from scenegen.scene import EMPTY

ERROR = 0.03  # of the light, relative to the hidden light
ROOMS = {
    "middle wall 0.5, floor 0.3": RoomSettings(middle_wall=0.5, floor=0.3),
    "middle wall and floor 0.05": RoomSettings(middle_wall=0.05, floor=0.05),
}


def main() -> None:
    """Print a row for each kind of measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("preset", help="of the scenes")
    parser.add_argument("--count", type=int, default=40, help="scenes, default 40")
    parser.add_argument("--seed", type=int, default=77)
    given = parser.parse_args()
    predictor = load(given.run, "cpu")
    errors: dict[str, list] = {}
    ratios: dict[str, list[float]] = {}
    warned: dict[str, list[bool]] = {}
    for light, rooms, fov_deg in measurements(predictor, given.preset, given.count, given.seed):
        depth_m = light.radial_depth_m
        dark = light.direct + light.hidden
        errors.setdefault("no object", []).append(no_object_metrics(depth_m, depth_m > 0))
        seen, captures = {"black room": dark}, {}
        for name, (full, empty) in rooms.items():
            ratios.setdefault(name, []).append(norm(full[..., 0]) / norm(light.hidden[..., 0]))
            seen |= dict.fromkeys((name, f"{name}, with a capture"), dark + full)
            captures[f"{name}, with a capture"] = light.direct + empty
        here = predictor.at(predictor.config.geometry.with_fov(fov_deg))
        for name, z in seen.items():
            answers = here.predict(z[None], captures.get(name))
            found, (light_found,) = answers[0], here.explained_light(z[None], answers, captures.get(name))
            told = light_found.findings(shows_object=bool(found.mask.any()))
            warned.setdefault(name, []).append(any(told))
            metrics = image_metrics(found.depth, found.mask, depth_m, depth_m > 0)
            errors.setdefault(name, []).append(metrics)
    head = ("measurement", "room / hidden light", "with a finding", "MAE, cm", "mIoU", "object MAE, cm")
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for name, metrics in errors.items():
        ratio = f"{np.median(ratios[name]):.2f}" if name in ratios else ""
        share = f"{np.mean(warned[name]):.0%}" if name in warned else ""
        print(f"| {name} | {ratio} | {share} | {' | '.join(summary_cells(summarise(metrics)))} |")


def measurements(
    predictor: Predictor, preset_name: str, count: int, seed: int
) -> Iterator[tuple[SceneLight, Mapping[str, tuple[Phasors, Phasors]], float]]:
    """Light of new scenes in a black room; that of each room, with object and empty; fields of view."""
    select_variant("cpu")
    config, given = predictor.config, load_preset(preset_name)
    width, height = config.image_width, config.image_height
    sized = replace(given.camera, width=width, height=height)
    preset = replace(given, camera=sized, dataset=replace(given.dataset, seed=seed))
    hz = config.inputs.frequencies_hz
    engine = SceneLights(hz, width, height, error=ERROR, device="cpu")
    method, maker = ManyLight(ManyLightOptions(error=ERROR), "llvm_ad_mono"), BlenderMaker()
    for index in range(count):
        scene = sample_valid_scene(preset, index, refusal)
        light = engine.of([(scene, {})])[scene.id]
        if not light.hidden.any():
            continue
        rooms = {}
        for name, room in ROOMS.items():
            full = in_room(scene, replace(preset, room=room))
            files = maker.files(full)
            view = View(TransientLayout(width, height, 1, 1.0, 0.0), hz, 3, scene.seed)
            both = (full, replace(full, hidden_objects=(), object_class=EMPTY))
            lit = (room_layer(each, files, Path(scene.id), method, view, light.hidden) for each in both)
            rooms[name] = tuple(each.phasors for each in lit)
        yield light, rooms, scene.camera.horizontal_fov_deg


def in_room(scene: Scene, preset: Preset) -> Scene:
    """The scene in the room of a preset."""
    return replace(scene, middle_wall=walls_of(preset)[1], room=room_of(preset))


if __name__ == "__main__":
    main()
