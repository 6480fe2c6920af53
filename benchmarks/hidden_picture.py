"""Draw docs/images/hidden_signal.png: the measurement of the camera and its hidden part, for three scenes.

Run:

    .venv/bin/python benchmarks/hidden_picture.py
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from seven_scenes import seven_scenes

from itof import TransientLayout, amplitude, phase
from render.backend import select_variant
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.mirrored import trace_ground_truth
from render.transport.scene_loading import load_scene

HZ = (20e6,)
TARGET = Path(__file__).parent.parent / "docs" / "images" / "hidden_signal.png"


def main() -> None:
    """Render three shapes at 160 x 120 and draw them."""
    layout = TransientLayout(160, 120, 2000, 0.01, 0.0)
    variant = select_variant()

    figure = Figure(figsize=(13, 8.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, 4)
    titles = (
        "in a mirror: radial depth, m",
        "measured: amplitude at 20 MHz",
        "hidden part, times 300",
        "hidden part: phase, rad",
    )
    with seven_scenes() as scenes:
        for row, (name, dataset, scene_id) in zip(axes, scenes[:3], strict=True):
            scene = load_scene(dataset, scene_id)
            mirrored = load_scene(dataset, scene_id, mirrored=True)
            truth = trace_ground_truth(mirrored, layout.width, layout.height, HZ[0])
            method = ManyLight(ManyLightOptions(lights=2048), variant)
            image = method.expose(scene, View(layout, HZ, 3, 1)).phasors()
            depth = np.where(truth.mask, truth.radial_depth_m, np.nan)
            top = amplitude(image.total).max()
            pictures = (
                (depth, "viridis", None, None),
                (amplitude(image.total)[..., 0], "gray", 0, top),
                (300 * amplitude(image.hidden)[..., 0], "gray", 0, top),
                (phase(image.hidden)[..., 0], "viridis", None, None),
            )
            for axis, (values, colours, low, high), title in zip(row, pictures, titles, strict=True):
                drawn = axis.imshow(values, cmap=colours, vmin=low, vmax=high)
                figure.colorbar(drawn, ax=axis, shrink=0.8)
                axis.set(xticks=[], yticks=[])
                axis.set_title(title if name == scenes[0][0] else "")
            row[0].set_ylabel(name.replace("_", " ").rsplit(" ", 1)[0])
    figure.savefig(TARGET, dpi=80)
    print(f"wrote {TARGET.relative_to(TARGET.parent.parent)}")


if __name__ == "__main__":
    main()
