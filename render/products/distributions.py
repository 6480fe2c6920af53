"""Distributions in a dataset: positions and rotations of objects, roughness, classes, object pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.products.tiles import class_name, is_rendered, read_ground_truth
from scenegen import Dataset, Preset, Split
from scenegen.scene import HiddenObject

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RELEASED_BACKGROUND_RATIO = 30.2  # background pixels per object pixel in the released code's training log
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
_BINS = 20
_COLOURS = {"train": "#4477aa", "validation": "#ccbb44", "test": "#ee6677"}
_FIRST, _SECOND = "#4477aa", "#ee9944"


@dataclass(frozen=True)
class Distributions:
    """Sampled values of N scenes, and object pixels of the rendered ones.

    Attributes
    ----------
    locations_m, rotations_deg : (N, 3) of the first object of each scene that has one.
    second_locations_m, second_rotations_deg : (M, 3) of the second objects of composites.
    roughness : of the relay wall, of all scenes where it is rough.
    class_counts : number of scenes by class and split; classes in the order of the dataset.
    object_pixels : number of object pixels in the ground truth, by id, of the rendered scenes.
    image_pixels : number of pixels of the image, by id, of the rendered scenes.
    image_sizes : all (width, height) of the rendered scenes, ascending.
    """

    locations_m: NDArray[np.float64]
    rotations_deg: NDArray[np.float64]
    second_locations_m: NDArray[np.float64]
    second_rotations_deg: NDArray[np.float64]
    roughness: tuple[float, ...]
    class_counts: dict[str, dict[Split, int]]
    object_pixels: dict[str, int]
    image_pixels: dict[str, int]
    image_sizes: tuple[tuple[int, int], ...]

    @property
    def background_per_object(self) -> float | None:
        """Background pixels per object pixel in all rendered scenes; None without object pixels."""
        on_object, all_pixels = sum(self.object_pixels.values()), sum(self.image_pixels.values())
        return (all_pixels - on_object) / on_object if on_object else None


def read_distributions(dataset: Dataset, on_scene: Callable[[], object]) -> Distributions:
    """Read all scenes and the ground truth of the rendered ones; call `on_scene` after each scene.

    Raises
    ------
    RenderFileError, ImageFileError : a ground truth differs from its record, or is damaged.
    DatasetError : a scene is missing or damaged.
    """
    first: list[HiddenObject] = []
    second: list[HiddenObject] = []
    roughness: list[float] = []
    class_counts: dict[str, dict[Split, int]] = {}
    object_pixels, image_pixels, sizes = {}, {}, set()
    for entry in dataset.index.scenes:
        scene = dataset.scene(entry.id)
        first += scene.hidden_objects[:1]
        second += scene.hidden_objects[1:]
        if scene.relay_wall.roughness is not None:
            roughness.append(scene.relay_wall.roughness)
        class_counts.setdefault(entry.object_class, dict.fromkeys(SPLITS, 0))[entry.split] += 1
        if is_rendered(dataset, entry.id):
            mask = read_ground_truth(dataset, entry.id).mask
            object_pixels[entry.id], image_pixels[entry.id] = int(mask.sum()), mask.size
            sizes.add((mask.shape[1], mask.shape[0]))
        on_scene()
    return Distributions(
        locations_m=np.array([part.location_m for part in first]).reshape(-1, 3),
        rotations_deg=np.array([part.rotation_deg for part in first]).reshape(-1, 3),
        second_locations_m=np.array([part.location_m for part in second]).reshape(-1, 3),
        second_rotations_deg=np.array([part.rotation_deg for part in second]).reshape(-1, 3),
        roughness=tuple(roughness),
        class_counts=class_counts,
        object_pixels=object_pixels,
        image_pixels=image_pixels,
        image_sizes=tuple(sorted(sizes)),
    )


def distributions_figure(found: Distributions, preset: Preset) -> Figure:
    """Histograms of all sampled values; dashed lines are the ranges in the preset."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, 3)
    places_m, turns_deg = preset.places_m, preset.turns_deg
    for axis, name in enumerate("xyz"):
        values = found.locations_m[:, axis], found.second_locations_m[:, axis]
        _histogram(axes[0, axis], values, getattr(places_m, name), f"position {name}, m")
        values = found.rotations_deg[:, axis], found.second_rotations_deg[:, axis]
        _histogram(axes[1, axis], values, getattr(turns_deg, name), f"rotation {name}, degrees")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=3, frameon=False, loc="outside upper center")
    _draw_roughness(axes[2, 0], found, preset)
    _draw_classes(axes[2, 1], found)
    _draw_object_pixels(axes[2, 2], found)
    for panel in axes.flat:
        panel.spines[["top", "right"]].set_visible(False)
    for panel, name in zip(axes[:, 0], ("objects", "objects", "scenes"), strict=True):
        panel.set_ylabel(name)
    return figure


def balance_sentence(found: Distributions) -> str:
    """The ratio of background to object pixels, with that of the authors' released code, as text."""
    if not found.object_pixels:
        return "no scene is rendered yet"
    per_object_pixel = found.background_per_object
    said = "no object pixel" if per_object_pixel is None else f"background/object {per_object_pixel:.1f}"
    return f"{said} (released code: {RELEASED_BACKGROUND_RATIO})"


def _histogram(
    panel: Axes,
    values: tuple[NDArray[np.float64], NDArray[np.float64]],
    asked: tuple[float, float],
    name: str,
) -> None:
    """Stacked histogram of first and second objects, with the range of the first in the preset."""
    low, high = (pick(np.concatenate([*values, asked])) for pick in (np.min, np.max))
    span, whole = asked[1] - asked[0], (high - low) or 1.0
    # The ends of the range are edges of bins, so that no bin is partly inside the range.
    width = span / max(1, round(_BINS * span / whole)) if span > whole / _BINS else whole / _BINS
    first, last = np.floor((low - asked[0]) / width), np.ceil((high - asked[0]) / width + 1e-9)
    edges = asked[0] + width * np.arange(first, last + 1)
    labels = ["first object", "second of a composite"]
    panel.hist(list(values), bins=edges.tolist(), stacked=True, color=[_FIRST, _SECOND], label=labels)
    for bound, label in zip(asked, ("range asked for", None), strict=True):
        panel.axvline(bound, color="0.2", linestyle="--", linewidth=1, label=label)
    panel.locator_params(axis="y", integer=True)
    panel.set_xlabel(name)


def _draw_roughness(panel: Axes, found: Distributions, preset: Preset) -> None:
    panel.set_xlabel("roughness of the relay wall")
    if not found.roughness:
        _say(panel, "the relay wall is diffuse")
        return
    counts = Counter(found.roughness)
    asked = sorted({*preset.relay_wall.roughness, *counts})
    width = 0.7 * min(np.diff(asked), default=0.05)
    panel.locator_params(axis="y", integer=True)
    panel.bar(asked, [counts[value] for value in asked], width=width, color=_FIRST)
    for bound in (asked[0] - width, asked[-1] + width):
        panel.axvline(bound, color="0.2", linestyle="--", linewidth=1)


def _draw_classes(panel: Axes, found: Distributions) -> None:
    names = [class_name(name) for name in found.class_counts]
    places = np.arange(len(names))
    before = np.zeros(len(names))
    for split in SPLITS:
        counts = np.array([by_split[split] for by_split in found.class_counts.values()])
        panel.barh(places, counts, left=before, color=_COLOURS[split], label=f"{split} {counts.sum()}")
        before = before + counts
    panel.set_yticks(places, names, fontsize=8)
    panel.invert_yaxis()
    panel.locator_params(axis="x", integer=True)
    panel.set_xlabel("scenes")
    panel.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.4, 1.0))


def _draw_object_pixels(panel: Axes, found: Distributions) -> None:
    panel.set_title(balance_sentence(found), fontsize=9)
    if not found.object_pixels:
        panel.set_xlabel("object pixels")
        _say(panel, "no scene is rendered yet")
        return
    panel.locator_params(axis="y", integer=True)
    panel.hist(list(found.object_pixels.values()), bins=_BINS, color=_FIRST)
    mean = float(np.mean(list(found.object_pixels.values())))
    panel.axvline(mean, color=_SECOND, linewidth=1.5, label=f"mean {mean:.0f}")
    panel.legend(frameon=False, fontsize=8)
    of = f" of {size_text(found.image_sizes)}" if len(found.image_sizes) == 1 else ""
    panel.set_xlabel(f"object pixels{of}")
    panel.set_ylabel(f"of {len(found.object_pixels)} rendered scenes")


def size_text(sizes: Sequence[tuple[int, int]]) -> str:
    """Image sizes as text, like ``320 x 240, 160 x 120``."""
    return ", ".join(f"{width} x {height}" for width, height in sizes)


def _say(panel: Axes, sentence: str) -> None:
    panel.text(0.5, 0.5, sentence, transform=panel.transAxes, ha="center", va="center", color="0.4")
    panel.set(xticks=[], yticks=[])
