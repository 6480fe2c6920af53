"""Random scenes. A scene depends only on the preset, the dataset's seed and the scene's index."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import floor

import numpy as np

from disk.quantities import Vector
from scenegen.object_settings import LocationRanges, RotationRanges
from scenegen.object_tables import BesideObject, OffsetRanges, Path, on_path
from scenegen.preset import Preset
from scenegen.room import walls_around
from scenegen.scene import (
    COMPOSITE,
    EMPTY,
    Camera,
    Darkening,
    Emitter,
    HiddenObject,
    MiddleWall,
    RelayWall,
    RoomWall,
    Scene,
    Split,
    Wall,
)


def sample_scene(preset: Preset, index: int, attempt: int = 0) -> Scene:
    """Draw scene `index`; `attempt` is the number of earlier draws that the geometry check refused.

    The random stream is seeded with (dataset seed, index, attempt). A scene therefore depends neither on the
    number of scenes nor on the order of work. All frames of a sequence have the stream of the first.
    """
    drawn = 0 if preset.is_sequence else index
    rng = np.random.default_rng([preset.dataset.seed, drawn, attempt])
    which, object_class, split = class_and_split(preset, index)
    parts = _sample_parts(preset, index, which, object_class, rng)
    roughness_index = int(rng.random() * len(preset.relay_wall.roughness))
    camera = _sample_camera(preset, rng)
    reflectance = _sample_reflectance(preset, rng)
    wall, darkening = preset.relay_wall, _sample_darkening(preset, rng)
    factor = _sample_size_factor(preset, rng)
    things = preset.object[0].things if preset.is_sequence else ()
    on_paths = [part for part, thing in zip(parts, things, strict=False) if thing.path_m]
    return Scene(
        index=index,
        dataset_seed=preset.dataset.seed,
        attempt=attempt,
        seed=int(np.random.SeedSequence([preset.dataset.seed, index]).generate_state(1)[0]),
        object_class=object_class,
        split=split,
        hidden_objects=tuple(
            _finished(part, part if part in on_paths else parts[0], reflectance, factor) for part in parts
        ),
        relay_wall=RelayWall(
            size_m=wall.size_m,
            location_m=wall.location_m,
            rotation_deg=wall.rotation_deg,
            material=wall.material,
            reflectance=wall.reflectance,
            roughness=wall.roughness[roughness_index] if wall.material == "rough" else None,
            darkening=darkening,
        ),
        middle_wall=walls_of(preset)[1],
        camera=camera,
        emitter=projector_of(preset, camera),
        max_bounces=preset.transient.max_bounces,
        mirror_occluders=preset.ground_truth.mirror_occluders,
        room=room_of(preset),
    )


def walls_of(preset: Preset) -> tuple[Wall, MiddleWall]:
    """Relay wall, without its material, and middle wall, which all scenes share."""
    relay, middle = preset.relay_wall, preset.middle_wall
    return (
        Wall(relay.size_m, relay.location_m, relay.rotation_deg),
        MiddleWall(middle.size_m, middle.location_m, middle.rotation_deg, preset.room.middle_wall),
    )


def room_of(preset: Preset) -> tuple[RoomWall, ...]:
    """Floor, ceiling and back wall of all scenes, as far as they reflect."""
    around = walls_around(*walls_of(preset))
    reflectances = {name: getattr(preset.room, name) for name in around}
    return tuple(
        RoomWall(wall.size_m, wall.location_m, wall.rotation_deg, name, reflectances[name])
        for name, wall in around.items()
        if reflectances[name] > 0
    )


def first_of_each_class(preset: Preset, most: int) -> list[int]:
    """The first scene of each class, or table `[[object]]`, among the first `most` scenes of a preset."""
    scenes = range(min(most, preset.dataset.count))
    first = {class_and_split(preset, index)[0]: index for index in reversed(scenes)}
    return sorted(first.values())


def class_and_split(preset: Preset, index: int) -> tuple[int, str, Split]:
    """Number and name of the class of scene `index`, and its split; of the first n scenes exactly the shares.

    Empty corners are distributed evenly over the scenes, and composites over the others; the other classes
    take turns. So the others have the classes of a preset without empty corners, in their order. The scenes
    of each class are distributed evenly over the splits, and each class starts at another point of the cycle.
    This makes the totals exact, too (Hermite's identity): of 1344 scenes, 860 are for training, 215 for
    validation and 269 for testing. The paper has 1075 and 269, and describes no validation split.
    """
    if preset.is_sequence:
        return 0, preset.object[0].class_name, "test"
    settings, hidden = preset.dataset, preset.hidden_object
    empty, fraction = hidden.empty_fraction, 0.0 if preset.object else hidden.pair_fraction
    usual = [each.class_name for each in preset.object] or hidden.shapes
    classes = [*usual, *[COMPOSITE] * (fraction > 0), *[EMPTY] * (empty > 0)]
    empty_before = _dealt(index, empty, 0.5)
    with_objects = index - empty_before
    composites_before = _dealt(with_objects, fraction, 0.5)
    if _dealt(index + 1, empty, 0.5) > empty_before:
        class_index, member = len(classes) - 1, empty_before
    elif _dealt(with_objects + 1, fraction, 0.5) > composites_before:
        class_index, member = len(usual), composites_before
    else:
        member, class_index = divmod(with_objects - composites_before, len(usual))
    start = (class_index + 0.5) / len(classes)
    split = _split_of_member(member, start, settings.test_fraction, settings.validation_fraction)
    return class_index, classes[class_index], split


def leaks(scenes: Iterable[Scene]) -> list[str]:
    """One sentence for each test scene that shares an object's location or orientation with another split.

    The paper's rule (sec. 5.2): an object of the training set is in the test set neither at the same location
    nor with the same orientation. The list is empty where the rule holds.
    """
    places = [
        (
            scene.id,
            scene.split == "test",
            [(part.location_m, part.rotation_deg) for part in scene.hidden_objects],
        )
        for scene in scenes
    ]
    found = []
    for which, name in enumerate(("location_m", "rotation_deg")):
        seen: dict[Vector, str] = {}
        for scene, is_test, parts in places:
            if not is_test:
                seen.update({part[which]: scene for part in parts})
        found += [
            f"test scene {scene} and scene {seen[part[which]]} share an object's {name}"
            for scene, is_test, parts in places
            if is_test
            for part in parts
            if part[which] in seen
        ]
    return found


def _split_of_member(member: int, start: float, test_fraction: float, validation_fraction: float) -> Split:
    tests_before = _dealt(member, test_fraction, start)
    if _dealt(member + 1, test_fraction, start) > tests_before:
        return "test"
    remaining = member - tests_before
    # Another starting point than for the test split: otherwise a class could get too few of both.
    start = (start + 0.75) % 1
    validations_before = _dealt(remaining, validation_fraction, start)
    return "validation" if _dealt(remaining + 1, validation_fraction, start) > validations_before else "train"


def _dealt(count: int, fraction: float, start: float) -> int:
    """How many of the first `count` items are selected when `fraction` of all is selected evenly."""
    # The margin makes 0.2 * 5 count as 1.0 in spite of rounding.
    return floor(count * fraction + start + 1e-9)


def _sample_parts(
    preset: Preset, index: int, which: int, object_class: str, rng: np.random.Generator
) -> list[HiddenObject]:
    """Objects of scene `index`, of the class number `which`, before what is drawn last for all of them."""
    if object_class == EMPTY:
        return []
    if preset.object:
        return _sample_listed(preset, index, which, rng)
    first = _sample_first(preset, object_class, rng)
    return [first, _sample_second(preset, first, rng)] if object_class == COMPOSITE else [first]


def _finished(part: HiddenObject, first: HiddenObject, reflectance: float, factor: float) -> HiddenObject:
    """An object with the reflectance of its scene, enlarged with the others about the centre of the first."""
    part = replace(part, reflectance=part.reflectance * reflectance)
    if factor == 1:
        return part
    x, y, z = (a + factor * (b - a) for a, b in zip(first.location_m, part.location_m, strict=True))
    width, depth, height = (factor * side for side in part.size_m)
    return replace(part, location_m=(x, y, z), size_m=(width, depth, height))


def _sample_listed(preset: Preset, index: int, which: int, rng: np.random.Generator) -> list[HiddenObject]:
    """The object of a table in scene `index`, and those beside it."""
    usual, listed = preset.hidden_object, preset.object[which]

    def drawn(ranges: LocationRanges | OffsetRanges | RotationRanges, path: Path | None = None) -> Vector:
        return on_path(path, index, preset.dataset.count) if path else _uniform(rng, _axes(ranges))

    places: list[Vector] = []
    parts = []
    for thing in listed.things:
        turns = thing.rotation_deg or usual.rotation_deg
        if isinstance(thing, BesideObject):
            beside = _sum(places[0], drawn(thing.offset_m))
            places.append(on_path(thing.path_m, index, preset.dataset.count) if thing.path_m else beside)
        else:
            places.append(drawn(listed.location_m or usual.location_m, listed.path_m))
        turn_deg = drawn(turns, thing.path_deg)
        extent_m = thing.extent_m(usual.size_m)
        parts.append(HiddenObject(thing.name, extent_m, places[-1], turn_deg, thing.reflectance))
    return parts


def _axes(ranges: LocationRanges | OffsetRanges | RotationRanges) -> list[tuple[float, float]]:
    return [ranges.x, ranges.y, ranges.z]


def _sample_first(preset: Preset, object_class: str, rng: np.random.Generator) -> HiddenObject:
    settings = preset.hidden_object
    shapes = settings.shapes
    shape = shapes[int(rng.random() * len(shapes))] if object_class == COMPOSITE else object_class
    location, rotation = settings.location_m, settings.rotation_deg
    return HiddenObject(
        shape=shape,
        size_m=settings.size_m.of(shape),
        location_m=_uniform(rng, _axes(location)),
        rotation_deg=_uniform(rng, _axes(rotation)),
        reflectance=1.0,  # see `_finished`
    )


def _sample_camera(preset: Preset, rng: np.random.Generator) -> Camera:
    """The camera of a scene; nothing is drawn where all scenes have the same one."""
    if preset.is_one_corner:
        return preset.camera
    spread, camera = preset.camera_spread, preset.camera
    moved, turned = (_uniform(rng, ((-by, by),) * 3) for by in (spread.location_m, spread.rotation_deg))
    by_deg = spread.horizontal_fov_deg
    wider_deg = by_deg * (2 * float(rng.random()) - 1) if by_deg else 0.0
    return replace(
        camera,
        horizontal_fov_deg=camera.horizontal_fov_deg + wider_deg,
        location_m=_sum(camera.location_m, moved),
        rotation_deg=_turned(camera.rotation_deg, turned),
    )


def projector_of(preset: Preset, camera: Camera) -> Emitter:
    """The projector of a scene with this camera."""
    own = preset.projector
    return Emitter(
        horizontal_fov_deg=own.horizontal_fov_deg or camera.horizontal_fov_deg,
        location_m=camera.location_m if own.location_m is None else own.location_m,
        rotation_deg=camera.rotation_deg if own.rotation_deg is None else own.rotation_deg,
        irradiance=1.0,
        dots=own.dots,
        spacing=own.spacing,
    )


def _sample_reflectance(preset: Preset, rng: np.random.Generator) -> float:
    """The reflectance of a scene's objects; nothing is drawn where all scenes have the same one."""
    least, most = preset.hidden_object.least_reflectance, preset.hidden_object.reflectance
    return most if least is None else least + (most - least) * float(rng.random())


def _sample_size_factor(preset: Preset, rng: np.random.Generator) -> float:
    """How much larger a scene's objects are; nothing is drawn where all have one size."""
    if preset.hidden_object.has_one_size:
        return 1.0
    least, most = preset.hidden_object.size_factor
    return least * (most / least) ** float(rng.random())


def _sample_darkening(preset: Preset, rng: np.random.Generator) -> Darkening | None:
    """How the relay wall of a scene darkens; nothing is drawn where it is the same everywhere."""
    least, most = preset.relay_wall.least_reflectance, preset.relay_wall.reflectance
    if least is None:
        return None
    darkest, turn = float(rng.random()), float(rng.random())
    return Darkening(least_reflectance=most - (most - least) * darkest, direction_deg=360 * turn)


def _sample_second(preset: Preset, first: HiddenObject, rng: np.random.Generator) -> HiddenObject:
    settings = preset.hidden_object
    others = [shape for shape in settings.shapes if shape != first.shape]
    shape = others[int(rng.random() * len(others))]
    offset = _uniform(rng, (settings.composite_offset_m,) * 3)
    turn = _uniform(rng, (settings.composite_rotation_deg,) * 3)
    return HiddenObject(
        shape=shape,
        size_m=settings.size_m.of(shape),
        location_m=_sum(first.location_m, offset),
        rotation_deg=_sum(first.rotation_deg, turn),
        reflectance=first.reflectance,
    )


def _uniform(rng: np.random.Generator, ranges: Sequence[tuple[float, float]]) -> Vector:
    # random() instead of uniform(): its stream is the same in all versions of numpy.
    x, y, z = (low + (high - low) * float(rng.random()) for low, high in ranges)
    return (x, y, z)


def _sum(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _turned(a: Vector, b: Vector) -> Vector:
    """Sums of angles; one beyond ±360 degrees, which no camera may have, is brought back by a turn."""
    x, y, z = (angle - 360 * np.sign(angle) if abs(angle) > 360 else angle for angle in _sum(a, b))
    return (float(x), float(y), float(z))
