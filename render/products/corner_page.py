"""The corner of a preset in 3-D: one HTML file that loads nothing from the network."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from disk import PathLike, data_folder
from render.products.conversion import exported_file
from render.products.corner_facts import CornerFacts
from render.products.corner_shapes import CAMERA, LIT, CornerShapes
from scenegen import Preset
from scenegen.corner_geometry import Points

_TEMPLATE: Final = "corner.html"  # in data/report
_DATA: Final = "CORNER_DATA"  # in the template
_FILL: Final = 0.2  # opacity of faces


def write_corner_page(preset: Preset, facts: CornerFacts, said: Sequence[str], file: PathLike) -> None:
    """Write the corner of a preset as a page that a reader turns, with what is `said` of it.

    Raises
    ------
    ExportError : `file` cannot be written.
    """
    page = (data_folder("report") / _TEMPLATE).read_text(encoding="utf-8")
    data = json.dumps(_page_data(preset, facts, said), allow_nan=False).replace("<", "\\u003c")
    with exported_file(file) as partial:
        partial.write_text(page.replace(_DATA, data), encoding="utf-8")


def _page_data(preset: Preset, facts: CornerFacts, said: Sequence[str]) -> dict[str, Any]:
    """What the page draws, as plain data: points in world axes, metres."""
    shapes = CornerShapes.of(preset, facts)
    everything = np.vstack([solid.points for solid in shapes.solids])
    low, high = np.round([everything.min(axis=0), everything.max(axis=0)], 4)
    dots = [
        {**_part("seen and lit", LIT, shapes.lit), "width": 1.5},
        {**_part("camera", CAMERA, shapes.eye[None]), "width": 6.0},
    ]
    return {
        "facts": list(said),
        "middle": _listed((low + high) / 2),
        "size": float(np.linalg.norm(high - low)),
        "parts": [
            *(
                {
                    **_part(solid.name, solid.colour, solid.points),
                    "faces": solid.faces,
                    "fill": 0.0 if solid.dotted else _FILL,
                    "dotted": solid.dotted,
                    "width": solid.width,
                }
                for solid in shapes.solids
            ),
            *dots,
        ],
        "distances": [{"ends": _listed(ends), "words": words} for ends, words in shapes.distances],
        **_floor(low, high),
    }


def _part(name: str, colour: str, points: Points) -> dict[str, Any]:
    """Dots, as faces of one corner each."""
    return {
        "name": name,
        "colour": colour,
        "points": _listed(points),
        "faces": [[i] for i in range(len(points))],
    }


def _floor(low: Points, high: Points) -> dict[str, Any]:
    """Lines of a grid of metres below everything, and the numbers at its ends."""
    x, y = (np.arange(np.floor(low[axis]), np.ceil(high[axis]) + 1) for axis in (0, 1))
    z = min(float(low[2]), 0.0)
    lines = [[[at, y[0], z], [at, y[-1], z]] for at in x] + [[[x[0], at, z], [x[-1], at, z]] for at in y]
    marks = [{"at": [at, y[0], z], "words": f"x {at:zg} m"} for at in x]
    marks += [{"at": [x[-1], at, z], "words": f"y {at:zg} m"} for at in y[1:]]
    return {"floor": lines, "marks": marks}


def _listed(values: Points) -> list[Any]:
    listed: list[Any] = np.round(values, 4).tolist()
    return listed
