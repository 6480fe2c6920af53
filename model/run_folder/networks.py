"""What a network needs of a measurement, from the files of its run, and what to do where none fits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from disk import PathLike
from disk.frequency_text import megahertz
from itof import pixel_rays
from itof.files.measurement_files import SAME_FREQUENCY
from itof.wall.expected_wall import radial_depth_of_plane
from itof.wall.finding import length
from itof.wall.plausibility import CALIBRATED_REFUSED_M
from itof.wall.wall_view import WallView
from model.run_folder.history import kept_epoch, read_history
from model.run_folder.run_config import RunConfig, read_config
from model.run_folder.shipped import run_folder, shipped_runs

SAME_VIEW_DEG: Final = 0.1  # moves the wall of the paper's corner by 2 mm at the edge of the image
OTHER_CORNER: Final = frozenset({"wall-moved", "other-view"})  # codes of what another network may not mind
_GRID: Final = (16, 12)  # rays over an image


@dataclass(frozen=True)
class View:
    """A camera in a corner, as far as it is known.

    Attributes
    ----------
    horizontal_fov_deg : degrees.
    plane_per_m : the relay wall in camera axes, 1/m (`itof.wall.expected_wall.plane_of`).
    """

    horizontal_fov_deg: float | None = None
    plane_per_m: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Wanted:
    """Images for which a network is wanted."""

    width: int
    height: int
    frequencies_hz: tuple[float, ...]
    views: tuple[View, ...] = ()


@dataclass(frozen=True)
class Network:
    """What a trained network needs, and how good it is.

    Attributes
    ----------
    name : of its run folder.
    width, height : of its images, pixels.
    fields_of_view_deg : smallest and largest horizontal field of view of its training.
    wall_shift_m : how far from its expected wall it knows walls, mean along the rays, metres; 0: one corner.
    any_size : whether it also reads images of several times this size.
    needs_capture : whether it needs a capture of the empty corner.
    is_of_camera : whether a modelled camera measured its training scenes.
    saw_captures : whether it measured the empty corner, too.
    noise : of its training scenes, relative to the amplitude; the largest.
    validation_mae_cm, validation_miou : at the end of its training; None if there is no history.
    """

    name: str
    width: int
    height: int
    frequencies_hz: tuple[float, ...]
    fields_of_view_deg: tuple[float, float]
    wall_shift_m: float
    any_size: bool
    needs_capture: bool
    is_of_camera: bool
    saw_captures: bool
    noise: float
    validation_mae_cm: float | None
    validation_miou: float | None

    @classmethod
    def of(cls, run: Path, config: RunConfig) -> Network:
        """The network of a run folder.

        Raises
        ------
        RunError : its history is damaged.
        """
        history, augmentation = read_history(run), config.settings.augmentation
        losses = history.get("validation_loss")
        kept = {}
        if losses:
            epoch = kept_epoch(losses, history.get("validation_uncertainty", [0.0] * len(losses)))
            kept = {name: history[name][epoch] for name in ("validation_mae_cm", "validation_miou")}
        return Network(
            name=run.resolve().name,
            width=config.image_width,
            height=config.image_height,
            frequencies_hz=config.inputs.frequencies_hz,
            fields_of_view_deg=config.trained_views_deg,
            wall_shift_m=config.inputs.largest_shift_m,
            any_size=config.inputs.shows_rays,
            needs_capture=config.inputs.needs_capture,
            is_of_camera=augmentation.camera is not None,
            saw_captures=config.saw_captures,
            noise=max(augmentation.noise_sigma, augmentation.largest_noise_sigma),
            validation_mae_cm=kept.get("validation_mae_cm"),
            validation_miou=kept.get("validation_miou"),
        )


def networks(runs: Sequence[PathLike] = ()) -> list[Network]:
    """The networks that come with the program, or those of run folders.

    Raises
    ------
    RunError : a folder is no run, or its files are damaged.
    """
    folders = [run_folder(run) for run in runs] or list(shipped_runs().values())
    return [Network.of(folder, read_config(folder)) for folder in folders]


def table(found: Sequence[Network]) -> str:
    """What networks need, as text in columns."""
    head = ("network", "pixels", "MHz", "field of view", "walls", "noise", "MAE, cm", "mIoU")
    rows = [head, *(tuple(_cells(network)) for network in found)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def _cells(network: Network) -> Iterator[str]:
    least_deg, most_deg = network.fields_of_view_deg
    yield network.name
    size = f"{network.width}x{network.height}"
    yield f"{size} and multiples" if network.any_size else size
    yield megahertz(*network.frequencies_hz).removesuffix(" MHz")
    yield f"{least_deg:.4g} deg" if least_deg == most_deg else f"{least_deg:.4g} to {most_deg:.4g} deg"
    place = f"within {length(network.wall_shift_m)}" if network.wall_shift_m else "in one place"
    yield place + (", and a capture of the empty corner" if network.needs_capture else "")
    noise = "of a camera" if network.is_of_camera else f"{network.noise:g}"
    yield noise + (", with captures" if network.saw_captures else "")
    accuracy = network.validation_mae_cm, network.validation_miou
    yield from ("-", "-") if None in accuracy else (f"{accuracy[0]:.2f}", f"{accuracy[1]:.3f}")


def wall_shift_m(trained: WallView, view: View) -> float:
    """How far a wall is from that of a run, metres: the mean along the rays that meet both."""
    fov_deg, plane_per_m = view.horizontal_fov_deg or trained.horizontal_fov_deg, view.plane_per_m
    if plane_per_m is None:
        return 0.0
    rays = pixel_rays(*_GRID, fov_deg)
    depth_m = radial_depth_of_plane(rays, np.asarray(plane_per_m))
    known_m = radial_depth_of_plane(rays, trained.plane_per_m)
    ahead = np.isfinite(depth_m) & np.isfinite(known_m)
    return float(np.abs(depth_m - known_m)[ahead].mean()) if ahead.any() else np.inf


def seen_view(trained: RunConfig, fov_deg: float) -> bool:
    """Whether the training of a network had cameras with this field of view, degrees."""
    least_deg, most_deg = trained.trained_views_deg
    return least_deg - SAME_VIEW_DEG <= fov_deg <= most_deg + SAME_VIEW_DEG


def readers(wanted: Wanted, *, can_be_smaller: bool) -> tuple[list[str], str]:
    """Names of the networks that come with the program and can read such images, and a sentence about them.

    Parameters
    ----------
    can_be_smaller : whether the images are of raw frames, which can be imported at a smaller size; the names
        of networks for such sizes are in the sentence alone.
    """
    names = fitting(wanted)
    told = [f"networks that can read it: {', '.join(names)}"] if names else []
    sizes = (
        {(config.image_width, config.image_height) for _, config in _shipped()} if can_be_smaller else set()
    )
    for width, height in sorted(sizes - {(wanted.width, wanted.height)}):
        if width <= wanted.width and height <= wanted.height:
            others = fitting(replace(wanted, width=width, height=height))
            told += [f"with --size {width}x{height}: {', '.join(others)}"] if others else []
    if not told:
        told = [f"no network that comes with NIGHT can read it; {what_to_do(wanted)}"]
    return names, "; ".join(told)


def fitting(wanted: Wanted) -> list[str]:
    """Names of the networks that come with the program and can read such images."""
    return [name for name, config in _shipped() if _fits(config, wanted)]


@cache
def _shipped() -> tuple[tuple[str, RunConfig], ...]:
    return tuple((name, read_config(folder)) for name, folder in shipped_runs().items())


def _fits(config: RunConfig, wanted: Wanted) -> bool:
    measured, needed = np.array(wanted.frequencies_hz), np.array(config.inputs.frequencies_hz)
    has_all = np.isclose(needed[:, None], measured, rtol=SAME_FREQUENCY, atol=0).any(1).all()
    reads_size = config.reads(wanted.width, wanted.height)
    known_m = config.inputs.largest_shift_m + CALIBRATED_REFUSED_M
    return bool(reads_size and has_all) and all(
        (view.horizontal_fov_deg is None or seen_view(config, view.horizontal_fov_deg))
        and wall_shift_m(config.geometry, view) < known_m
        for view in wanted.views
    )


def what_to_do(wanted: Wanted | None = None) -> str:
    """What to do where a network does not fit images, as the end of a sentence: another one, or make one."""
    make = (
        "night-train --for PRESET --out RUN makes a network for the corner and camera of a preset of scenes, "
        "or with --gap of a capture of the empty corner"
    )
    if wanted is None:
        return make
    names: Iterable[str] = fitting(wanted)
    fits = "which fits" if wanted.views else "with this size and these frequencies"
    return f"take {' or '.join(names)}, {fits}" if names else make
