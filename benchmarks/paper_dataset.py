"""The 1344 scenes of the paper: time in Blender, sizes of the splits, ratio of background to object pixels.

The training log of the released code gives a ratio of 30.2. Comparing it with our ratio checks the sizes of
the primitives (docs/science/design.md, Primitive sizes). Run:

    .venv/bin/python benchmarks/paper_dataset.py
"""

import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from render.backend import select_variant
from render.transport.mirrored import trace_ground_truth
from render.transport.scene_loading import load_scene
from scenegen import leaks, load_preset
from scenegen.making.blender import BlenderMaker
from scenegen.making.generation import generate

WIDTH, HEIGHT = 80, 60
REFERENCE_HZ = 20e6


def main() -> None:
    """Make the scenes, trace one ray per pixel of each mirrored scene, and print the results."""
    with TemporaryDirectory() as folder:
        maker = BlenderMaker()
        started = time.perf_counter()
        dataset = generate(Path(folder) / "paper", load_preset("paper"), maker, lambda: None)
        print(f"{len(dataset.ids())} scenes made in {time.perf_counter() - started:.1f} s")
        scenes = [dataset.scene(scene_id) for scene_id in dataset.ids()]
        print("splits:", dict(Counter(scene.split for scene in scenes)), "leaks:", len(leaks(scenes)))
        print("redrawn by the geometry check:", sum(scene.attempt > 0 for scene in scenes))
        select_variant()

        on_object = 0
        for scene_id in dataset.ids():
            mirrored = load_scene(dataset, scene_id, mirrored=True)
            truth = trace_ground_truth(mirrored, WIDTH, HEIGHT, REFERENCE_HZ)
            on_object += int(truth.mask.sum())
        pixels = WIDTH * HEIGHT * len(scenes)
        print(f"background/object pixel ratio at {WIDTH} x {HEIGHT}: {(pixels - on_object) / on_object:.1f}")


if __name__ == "__main__":
    main()
