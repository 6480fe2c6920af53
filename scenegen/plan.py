"""The scenes of a dataset from above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from scenegen.corner_geometry import corners_of, lit_points
from scenegen.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_plan(scenes: Sequence[Scene]) -> Figure:
    """Walls of the first scene, with what its camera sees lit, and camera and objects of all; metres."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    first = scenes[0]
    for name, wall, colour in (
        ("relay wall", first.relay_wall, "0.7"),
        ("middle wall", first.middle_wall, "k"),
    ):
        axes.plot(*corners_of(wall)[:, :2].T, color=colour, linewidth=3, label=name)
    lit = lit_points(first.camera, first.emitter, first.relay_wall, first.middle_wall)
    axes.plot(*lit[:, :2].T, color="gold", linewidth=3, label="lit and seen")
    axes.plot(*np.array([scene.camera.location_m for scene in scenes])[:, :2].T, "k^", label="camera")
    for kind in sorted({scene.object_class for scene in scenes}):
        solids = [each for scene in scenes if scene.object_class == kind for each in scene.hidden_objects]
        if solids:
            axes.plot(*np.array([each.location_m for each in solids])[:, :2].T, ".", label=kind)
    axes.set(aspect="equal", xlabel="x, m", ylabel="y, m")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
    return figure
