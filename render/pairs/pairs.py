"""Datasets of measured pairs: a capture of the corner, and one of a mirror on its relay wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from disk import PathLike, whole_folder, write_text
from disk.frequency_text import megahertz
from itof import DepthMap, phasor_channels, write_image
from itof.capture.record import imported_fov_deg, read_import_record
from itof.files.measurement_files import Measurement, read_measurement
from itof.files.measurement_writing import ENDINGS
from itof.light import OFFSET_STD_RAD
from itof.wall.empty_corner import CapturedPlane, find_wall
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallView
from itof.weighted_reference import weighted_reference
from render.pairs.relay_wall import relay_wall_at
from render.pairs.truth import MirrorError, MirrorTruth, Region, truth_of_mirror, wall_offsets_rad
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    Dataset,
    Preset,
    Scene,
    build_index,
    open_dataset,
    sample_scene,
    scene_entry,
    scene_to_json,
    write_index,
)
from scenegen.dataset import MEASURED_GENERATOR
from scenegen.depth_range import boxes
from scenegen.pose import wall_geometry
from scenegen.projector import ProjectorSettings
from scenegen.scene import HiddenObject

WallSource = Literal["empty", "preset"]  # of the relay wall's place
MEASURED: Final = "measured"  # object class of the scenes
_SAME_DEG: Final = 1e-3
MEASUREMENT_NAME, MIRROR_NAME = "measurement", "mirror"


@dataclass(frozen=True)
class Pair:
    """A measurement and the truth that belongs to it."""

    measurement: Measurement
    truth: MirrorTruth


@dataclass(frozen=True)
class WrittenPairs:
    """Outcome of `write_pairs`: the dataset, and the wall of its empty corners (None: nobody looked)."""

    dataset: Dataset
    wall: CapturedPlane | None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The outcome as text."""
        return (*([] if self.wall is None else [self.wall.sentence]), self.dataset.sentence())


def write_pairs(
    folders: Sequence[PathLike], preset: Preset, out: PathLike, *, wall: WallSource = "empty"
) -> WrittenPairs:
    """Make a dataset of measured pairs, which `night-train` and `night-eval` read like a rendered one.

    Each folder has two files as `night-eval capture import` writes them: ``measurement.npz`` (or ``.h5``),
    and ``mirror.npz``, by the same camera with a mirror on the relay wall. A `reference` in the measurement
    takes the camera's errors out of it: the dataset has what the camera would give without them.

    Parameters
    ----------
    folders : of the pairs, in the order of the scenes.
    preset : the corner: camera, relay wall, region of the hidden object, frequencies, and the fractions of
        the splits. Its image size and number of scenes are replaced by those of the pairs.
    out : dataset folder; must not exist.
    wall : where the relay wall is: where captures of the empty corner show it, if there are any
        (``"empty"``) to a centimetre, or where the preset has it. The rest of the corner stays.

    Returns
    -------
    The dataset, and what the empty corners say of the wall.

    Raises
    ------
    MirrorError : `out` exists, a file is missing, a pair is named twice, the pairs differ in size or in their
        field of view from the preset, the preset has many corners, or one of `truth_of_mirror`.
    MeasurementError : a file is damaged, or lacks a frequency of the preset.
    """
    out = Path(out).resolve()
    if out.exists():
        raise MirrorError(f"{out} exists already: choose another folder for the dataset")
    if not folders:
        raise MirrorError("a dataset needs at least one pair")
    if len({Path(folder).resolve() for folder in folders}) < len(folders):
        raise MirrorError("a pair is named twice: it could be in the training and in the test")
    if not preset.is_one_corner:
        raise MirrorError(
            "the preset moves the camera from scene to scene (camera_spread): describe one corner"
        )
    if preset.projector != ProjectorSettings():
        raise MirrorError("the preset has a projector of its own: a capture needs a flash at the camera")
    measured = [_read(Path(folder), preset) for folder in folders]
    height, width = _only_size(folders, measured)
    of_pairs = replace(
        preset,
        dataset=replace(preset.dataset, count=len(folders), frame_rate_hz=None),
        camera=replace(preset.camera, width=width, height=height),
        hidden_object=replace(preset.hidden_object, shapes=("sphere",), composite_fraction=0.0),
        object=(),
    )
    scenes = [sample_scene(of_pairs, index) for index in range(len(folders))]
    view = WallView(**wall_geometry(scenes[0].camera, scenes[0].relay_wall))
    frequencies_hz = preset.itof.frequencies_hz
    expected = view.expected_wall(view.direct_phasors(width, height, frequencies_hz), frequencies_hz)
    for place, (measurement, _) in zip(folders, measured, strict=True):
        _refuse_other_wall(Path(place), measurement, expected)
    found = None
    corners = [each.reference for each, _ in measured if each.reference is not None]
    if wall == "empty" and corners:
        known_rad = max(_offset_std_rad(Path(folder)) for folder in folders)
        found = find_wall(corners, expected, known_rad, needs_distance=True)
    if found is not None and found.is_certain:
        walls = [relay_wall_at(found.plane_per_m, scene.relay_wall, view) for scene in scenes]
        scenes = [replace(scene, relay_wall=there) for scene, there in zip(scenes, walls, strict=True)]
        view = WallView(**wall_geometry(scenes[0].camera, scenes[0].relay_wall))
        expected = view.expected_wall(view.direct_phasors(width, height, frequencies_hz), frequencies_hz)
    region = region_of(preset, view)
    with whole_folder(out) as folder:
        entries = []
        for place, (measurement, mirror), scene in zip(folders, measured, scenes, strict=True):
            pair = _pair(Path(place), measurement, mirror, expected, region)
            described = _described(scene, pair.truth, view)
            text = scene_to_json(described)
            write_text(folder / "scenes" / scene.id / "scene.json", text)
            entries.append(scene_entry(described, {"scene.json": text.encode()}))
            _write_images(folder / "renders" / scene.id, pair, expected.direct, frequencies_hz)
        index = build_index(of_pairs, entries, "none")
        write_index(folder, replace(index, generator=MEASURED_GENERATOR))
    return WrittenPairs(open_dataset(out), found)


def region_of(preset: Preset, view: WallView) -> Region:
    """The smallest sphere about all hidden objects that a preset can have, in camera axes."""
    spheres = [(box.mean(axis=1), np.linalg.norm(np.ptp(box, axis=1)) / 2 + r) for box, r in boxes(preset)]
    centre = np.mean([middle for middle, _ in spheres], axis=0)
    radius_m = max(float(np.linalg.norm(middle - centre) + r) for middle, r in spheres)
    seen = np.asarray(view.camera_axes) @ (centre - np.asarray(view.camera_location_m))
    return Region(seen, radius_m)


def _offset_std_rad(folder: Path) -> float:
    """How well the camera's phase offsets are known, by the record of the import of the measurement."""
    records = [read_import_record(folder / f"{MEASUREMENT_NAME}{ending}") for ending in ENDINGS]
    known = [max(record.sidecar.offset_std_rad) for record in records if record is not None]
    return max(known, default=OFFSET_STD_RAD)


def _read(folder: Path, preset: Preset) -> tuple[Measurement, Measurement]:
    found = []
    for name in (MEASUREMENT_NAME, MIRROR_NAME):
        files = [folder / f"{name}{ending}" for ending in ENDINGS if (folder / f"{name}{ending}").is_file()]
        if len(files) != 1:
            there = "none" if not files else f"{len(files)} of them"
            raise MirrorError(
                f"{folder} must hold one {name}.npz (or .h5) as night-eval capture import writes it; there "
                f"is {there}"
            )
        found.append(read_measurement(files[0]).at(preset.itof.frequencies_hz))
        _refuse_other_view(found[-1], preset)
    return found[0], found[1]


def _refuse_other_view(measured: Measurement, preset: Preset) -> None:
    """Refuse a capture with another field of view than the preset's camera, as far as it is known."""
    imported_deg, wanted_deg = imported_fov_deg(measured.path), preset.camera.horizontal_fov_deg
    for fov_deg in measured.fields_of_view_deg or ([] if imported_deg is None else [imported_deg]):
        if abs(fov_deg - wanted_deg) > _SAME_DEG:
            raise MirrorError(
                f"{measured.path} is {fov_deg:.2f} degrees wide and the camera of the preset "
                f"{wanted_deg:g}: import it with --fov {wanted_deg:g}, or change the preset"
            )


def _only_size(
    folders: Sequence[PathLike], measured: Sequence[tuple[Measurement, Measurement]]
) -> tuple[int, int]:
    """Height and width of all images."""
    sizes = [each.phasors.shape[1:3] for pair in measured for each in pair]
    for place, size in enumerate(sizes):
        if size != sizes[0]:
            raise MirrorError(
                f"{folders[place // 2]} has images of {size[1]}x{size[0]} pixels and {folders[0]} of "
                f"{sizes[0][1]}x{sizes[0][0]}: import all of them at one size"
            )
    height, width = sizes[0]
    return int(height), int(width)


def _refuse_other_wall(folder: Path, measurement: Measurement, wall: ExpectedWall) -> None:
    """Refuse a measurement that does not show the preset's wall."""
    try:
        wall_offsets_rad(_corner_of(measurement), wall)
    except MirrorError as error:
        raise MirrorError(f"{folder}: {error}") from None


def _corner_of(measurement: Measurement) -> NDArray[np.complexfloating[Any, Any]]:
    """(H, W, F) the empty corner; without a capture of it, the measurement."""
    known = measurement.reference
    return measurement.phasors.mean(axis=0) if known is None else known


def _pair(
    folder: Path, measurement: Measurement, mirror: Measurement, wall: ExpectedWall, region: Region
) -> Pair:
    lit = measurement.phasors.any(axis=(0, 1, 2))  # (F,)
    if not lit.all():
        dark = megahertz(*np.array(measurement.frequencies_hz)[~lit], between=" and ")
        raise MirrorError(f"{folder}: the measurement holds no light at {dark}: capture it again")
    try:
        corner, hz = _corner_of(measurement), measurement.frequencies_hz
        truth = truth_of_mirror(mirror.phasors.mean(axis=0), corner, wall, region, hz)
    except MirrorError as error:
        raise MirrorError(f"{folder}: {error}") from None
    return Pair(measurement, truth)


def _described(scene: Scene, truth: MirrorTruth, view: WallView) -> Scene:
    """The scene with a sphere about what the mirror shows of the object, in world axes."""
    low, high = truth.object_points_m.min(axis=0), truth.object_points_m.max(axis=0)
    centre = (low + high) / 2 @ np.asarray(view.camera_axes) + np.asarray(view.camera_location_m)
    side = max(float(np.linalg.norm(high - low)), 1e-3)
    x, y, z = centre.tolist()
    sphere = HiddenObject("sphere", (side, side, side), (x, y, z), (0.0, 0.0, 0.0), 1.0)
    return replace(scene, object_class=MEASURED, hidden_objects=(sphere,))


def _write_images(
    folder: Path, pair: Pair, direct: NDArray[np.complexfloating[Any, Any]], frequencies_hz: Sequence[float]
) -> None:
    """The measurement in the unit of rendered scenes, without the errors that its reference shows."""
    phasor = pair.measurement.phasors.mean(axis=0)
    known = pair.measurement.reference
    if known is not None:
        seen = ((known != 0) & (direct != 0)).all(axis=-1, keepdims=True)  # elsewhere, rays miss the wall
        clean = weighted_reference(direct, np.abs(known[..., 0]))
        with_errors, without = np.where(seen, known, 1), np.where(seen, clean, 0)
        turn = without / with_errors * np.abs(with_errors[..., :1])
        phasor = phasor * turn / np.where(seen, np.abs(direct[..., :1]), 1)
    bright = float(np.abs(phasor[..., 0]).mean())
    if not bright > 0:
        raise MirrorError(f"{pair.measurement.path} has no light where it sees the wall: capture it again")
    with np.errstate(over="ignore", invalid="ignore"):
        phasor = phasor * (float(np.abs(direct[..., 0]).mean()) / bright)
    if not np.isfinite(phasor).all():
        raise MirrorError(f"{pair.measurement.path} has numbers that are too small or too large: scale them")
    folder.mkdir(parents=True)
    source = {"source": str(pair.measurement.path.name)}
    write_image(folder / MEASUREMENT_FILE, phasor_channels(phasor, frequencies_hz), source)
    truth: DepthMap = pair.truth.depth_map
    truth.write(folder / GROUND_TRUTH_FILE, source)
