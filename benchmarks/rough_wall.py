"""Direct light that the reference leaves in the residual channels, on rough walls, by image size.

Renders one scene of every class at 320 x 240 and averages pixels, which is exact for phasors. The error is
that of the channels Im r_f against those with the rendered direct part as reference, relative to these. Run:

    .venv/bin/python benchmarks/rough_wall.py
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from itof import SubpixelWeights, TransientLayout, residual_channels
from model.data.corner import wall_view
from render.backend import select_variant
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.scene_loading import load_scene
from scenegen import preset_from_dict
from scenegen.making.blender import BlenderMaker
from scenegen.making.generation import generate

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 320, 240
FACTORS = (16, 8, 4, 2, 1)
WEIGHTS: tuple[SubpixelWeights, ...] = ("uniform", "measured")


def main() -> None:
    """Print a table for each roughness."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--roughness", type=float, nargs="+", default=[0.3, 0.5, 1.0])
    parser.add_argument("--lights", type=int, default=256, help="of each render, default 256")
    given = parser.parse_args()
    variant, maker = select_variant(), BlenderMaker()
    print(
        "| roughness | size | uniform: median, worst of 7 | measured: median, worst of 7 |\n|---|---|---|---|"
    )
    for roughness in given.roughness:
        data = {"dataset": {"count": 7}, "relay_wall": {"roughness": [roughness]}}
        preset = preset_from_dict(data, "benchmark")
        with TemporaryDirectory() as folder:
            dataset = generate(Path(folder), preset, maker, lambda: None)
            view, layout = wall_view(dataset), TransientLayout(WIDTH, HEIGHT, 2000, 0.01, 0.0)
            method = ManyLight(ManyLightOptions(lights=given.lights), variant)
            images = [
                method.expose(load_scene(dataset, scene), View(layout, HZ, 3, 1)).phasors()
                for scene in dataset.ids()
            ]
        for factor in FACTORS:
            size = WIDTH // factor, HEIGHT // factor
            reference = view.direct_phasors(*size, HZ)
            found = {
                weights: 100
                * np.array(
                    [
                        error(
                            coarser(image.direct, factor), coarser(image.hidden, factor), reference, weights
                        )
                        for image in images
                    ]
                )
                for weights in WEIGHTS
            }
            cells = [f"{np.median(each):.2g} %, {each.max():.2g} %" for each in found.values()]
            print(f"| {roughness:g} | {size[0]} x {size[1]} | {cells[0]} | {cells[1]} |", flush=True)


def coarser(phasor: NDArray[np.complexfloating], factor: int) -> NDArray[np.complexfloating]:
    """Means over factor x factor pixels of (H, W, F) phasors."""
    height, width, count = phasor.shape
    return phasor.reshape(height // factor, factor, width // factor, factor, count).mean(axis=(1, 3))


def error(
    direct: NDArray[np.complexfloating],
    hidden: NDArray[np.complexfloating],
    reference: NDArray[np.complexfloating],
    weights: SubpixelWeights,
) -> float:
    """Error of the channels Im r_f, relative to their hidden light."""
    right = residual_channels(direct + hidden, direct, "uniform")[: len(HZ)]
    found = residual_channels(direct + hidden, reference, weights)[: len(HZ)]
    return float(np.linalg.norm(found - right) / np.linalg.norm(right))


if __name__ == "__main__":
    main()
