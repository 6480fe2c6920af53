"""Presets: every number of a dataset, with its unit and its allowed range; read from TOML, checked once.

Defaults are the values of Caligiuri et al. 2024 where the paper gives them, else those of the released code,
else ours (docs/science/design.md, Scene).
"""

from __future__ import annotations

from dataclasses import replace
from math import gcd
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, TypeAdapter
from pydantic.dataclasses import dataclass
from scipy.constants import speed_of_light

from disk.contract import STRICT, checked_data
from disk.frequency_text import megahertz
from disk.path_like import PathLike
from disk.preset_files import PresetError, read_settings
from disk.quantities import (
    FARTHEST_M,
    MAX_FOV_DEG,
    MIN_FOV_DEG,
    CameraMove,
    Distance,
    FieldOfView,
    Fraction,
    FrameRate,
    Frequency,
    Length,
    Location,
    QuarterTurn,
    Reflectance,
    Rotation,
    Roughness,
    Seed,
)
from scenegen.object_settings import HiddenObjectSettings, LocationRanges, RotationRanges, distinct
from scenegen.object_tables import ListedObject
from scenegen.projector import ProjectorSettings
from scenegen.shapes import PRIMITIVES, Shape

Material = Literal["rough", "diffuse"]
MOST_BOUNCES = 64  # surfaces that light may meet on its way
MAX_SCANLINE_VALUES = 2**31  # OpenEXR counts a scanline's values (image width x bins) in 32 bits
_MOST_PROJECTOR_PIXELS = 2**26


@dataclass(frozen=True, config=STRICT)
class DatasetSettings:
    """Number of scenes, random seed, and split into train, validation and test.

    `test_fraction` is a fraction of all scenes, `validation_fraction` of the scenes that are not for testing.
    The paper describes no validation split; its size is ours. With a `frame_rate_hz`, the scenes are the
    frames of one sequence, all in the test split. They share all that is drawn, and the object follows its
    path (`ListedObject`).
    """

    count: Annotated[int, Field(ge=1, le=1_000_000)] = 1344  # ids have six digits
    seed: Seed = 0
    test_fraction: Fraction = 0.2
    validation_fraction: Fraction = 0.2
    frame_rate_hz: Annotated[FrameRate | None, Field(exclude_if=lambda value: value is None)] = None


@dataclass(frozen=True, config=STRICT)
class RelayWallSettings:
    """The wall that camera and hidden object both see.

    Before its rotation it faces +z; `size_m` is along its own x and y. Each scene draws one value of
    `roughness` (alpha of Mitsuba's ``roughplastic``); a ``diffuse`` wall has none. If there is a
    `least_reflectance`, the reflectance of each scene's wall falls linearly in a random direction: from
    `reflectance` at its brightest corner to a value between that and `least_reflectance`, drawn evenly.
    """

    material: Material = "rough"
    roughness: Annotated[tuple[Roughness, ...], Field(min_length=1), AfterValidator(distinct)] = (
        *(0.30, 0.35, 0.40, 0.45, 0.50, 0.55, 0.60, 0.65),
        *(0.70, 0.75, 0.80, 0.85, 0.90, 0.95, 1.00),
    )
    reflectance: Reflectance = 1.0
    least_reflectance: Annotated[Reflectance | None, Field(exclude_if=lambda value: value is None)] = None
    size_m: tuple[Length, Length] = (4.0, 8.0)
    location_m: Location = (0.0, 0.0, 2.0)
    rotation_deg: Rotation = (0.0, 90.0, 0.0)


@dataclass(frozen=True, config=STRICT)
class MiddleWallSettings:
    """The wall that hides the object from the camera; geometry as of `RelayWallSettings`."""

    size_m: tuple[Length, Length] = (3.3, 4.0)
    location_m: Location = (2.35, 0.0, 2.0)
    rotation_deg: Rotation = (90.0, 0.0, 0.0)


@dataclass(frozen=True, config=STRICT)
class CameraSettings:
    """The camera: image size in pixels, field of view, and pose (Blender: it looks along its own -z).

    The projector has the same pose and the same frustum, unless `ProjectorSettings` says otherwise.
    """

    width: Annotated[int, Field(ge=1, le=100_000)] = 320
    height: Annotated[int, Field(ge=1, le=100_000)] = 240
    horizontal_fov_deg: FieldOfView = 60.0
    location_m: Location = (1.0, -1.0, 1.65)
    rotation_deg: Rotation = (90.0, 0.0, 50.0)


@dataclass(frozen=True, config=STRICT)
class CameraSpread:
    """Each scene has its camera elsewhere: a dataset of many corners.

    Every coordinate of `CameraSettings.location_m` is moved by up to `location_m`, and every angle of its
    rotation by up to `rotation_deg`, either way and evenly distributed; so is its field of view, by up to
    `horizontal_fov_deg`. The projector goes with the camera.
    """

    location_m: CameraMove = 0.0
    rotation_deg: QuarterTurn = 0.0
    # Left out of files where it is 0, so that datasets without it keep their bytes.
    horizontal_fov_deg: Annotated[QuarterTurn, Field(exclude_if=lambda value: value == 0)] = 0.0


@dataclass(frozen=True, config=STRICT)
class TransientSettings:
    """Time axis, and the number of surfaces that light may meet (`max_bounces`).

    Bin width and start are optical path lengths (out and back), metres.
    """

    bin_count: Annotated[int, Field(ge=1, le=10_000_000)] = 2000
    bin_width_m: Length = 0.01
    start_opl_m: Distance = 0.0
    max_bounces: Annotated[int, Field(ge=1, le=MOST_BOUNCES)] = 3


@dataclass(frozen=True, config=STRICT)
class ItofSettings:
    """Modulation frequencies of the camera, Hz, lowest first."""

    frequencies_hz: Annotated[tuple[Frequency, ...], Field(min_length=1), AfterValidator(distinct)] = (
        20e6,
        50e6,
        60e6,
    )

    def __post_init__(self) -> None:
        if list(self.frequencies_hz) != sorted(self.frequencies_hz):
            raise ValueError("frequencies_hz must ascend: the first is the reference of the network channels")


@dataclass(frozen=True, config=STRICT)
class GroundTruthSettings:
    """What the mirrored scenes of the ground truth contain.

    `mirror_occluders`: whether the mirror image of the middle wall hides objects, as in a real mirror. The
    paper's recipe (sec. 4.1) flips the object only.
    """

    mirror_occluders: bool = False


@dataclass(frozen=True, config=STRICT)
class RoomSettings:
    """Reflectances of the diffuse surfaces around the corner; 0, as in the paper, is a black surface.

    `floor`, `ceiling` and `back_wall` complete the room (`scenegen.room.walls_around`).
    """

    middle_wall: Reflectance = 0.0
    floor: Reflectance = 0.0
    ceiling: Reflectance = 0.0
    back_wall: Reflectance = 0.0


@dataclass(frozen=True, config=STRICT)
class Preset:
    """All settings of a dataset. The defaults are those of the preset ``paper``.

    Where there are tables `object`, scenes take turns among them and have no shapes of `hidden_object`.
    """

    dataset: DatasetSettings = DatasetSettings()
    hidden_object: HiddenObjectSettings = HiddenObjectSettings()
    relay_wall: RelayWallSettings = RelayWallSettings()
    middle_wall: MiddleWallSettings = MiddleWallSettings()
    camera: CameraSettings = CameraSettings()
    transient: TransientSettings = TransientSettings()
    itof: ItofSettings = ItofSettings()
    # Left out of files where they are the default, so that these have the bytes of version 0.1.
    camera_spread: Annotated[CameraSpread, Field(exclude_if=lambda value: value == CameraSpread())] = (
        CameraSpread()
    )
    projector: Annotated[ProjectorSettings, Field(exclude_if=lambda value: value == ProjectorSettings())] = (
        ProjectorSettings()
    )
    ground_truth: Annotated[
        GroundTruthSettings, Field(exclude_if=lambda value: value == GroundTruthSettings())
    ] = GroundTruthSettings()
    room: Annotated[RoomSettings, Field(exclude_if=lambda value: value == RoomSettings())] = RoomSettings()
    object: Annotated[tuple[ListedObject, ...], Field(exclude_if=lambda value: not value)] = ()

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes of all hidden objects that scenes may have, each once."""
        listed = dict.fromkeys(thing.name for each in self.object for thing in each.things)
        return tuple(listed) or self.hidden_object.shapes

    @property
    def places_m(self) -> LocationRanges:
        """The smallest box around the ranges of all first objects of scenes."""
        usual = self.hidden_object.location_m
        found = [each.places_m(usual) for each in self.object] or [usual]
        return LocationRanges(*(_around([getattr(each, axis) for each in found]) for axis in "xyz"))

    @property
    def turns_deg(self) -> RotationRanges:
        """The same of their angles."""
        usual = self.hidden_object.rotation_deg
        found = [each.turns_deg(usual) for each in self.object] or [usual]
        return RotationRanges(*(_around([getattr(each, axis) for each in found]) for axis in "xyz"))

    @property
    def is_one_corner(self) -> bool:
        """Whether all scenes have the same camera and the same relay wall, but for its roughness."""
        return self.camera_spread == CameraSpread()

    @property
    def is_sequence(self) -> bool:
        """Whether the scenes are the frames of one sequence."""
        return self.dataset.frame_rate_hz is not None

    def continues(self, before: Preset) -> bool:
        """Whether the scenes of `before` are the first ones of this preset, or its first are those."""
        if self.is_sequence:  # more frames are other frames
            return self == before
        return replace(self, dataset=replace(self.dataset, count=before.dataset.count)) == before

    def __post_init__(self) -> None:
        if self.object and self.hidden_object.shapes != PRIMITIVES:
            raise ValueError("give hidden_object.shapes or tables [[object]], not both")
        moves = any(thing.path_m or thing.path_deg for each in self.object for thing in each.things)
        if moves and not self.is_sequence:
            raise ValueError("object.path_m and path_deg are for a sequence: give dataset.frame_rate_hz, too")
        if self.is_sequence and (len(self.object) != 1 or self.hidden_object.empty_fraction):
            raise ValueError(
                "dataset.frame_rate_hz makes the scenes frames of one sequence, which show the same object: "
                "give one table [[object]], and no hidden_object.empty_fraction"
            )
        self.hidden_object.refuse_sizes(
            side
            for each in self.object
            for thing in each.things
            if thing.size_m and not thing.unit
            for side in thing.extent_m(self.hidden_object.size_m)
        )
        ups = {(thing.name, thing.up) for each in self.object for thing in each.things}
        if len(ups) > len({name for name, _ in ups}):
            raise ValueError(
                "a mesh file has one up axis: give the same up wherever [[object]] names the file"
            )
        fov_deg, spread_deg = self.camera.horizontal_fov_deg, self.camera_spread.horizontal_fov_deg
        if spread_deg and not (fov_deg - spread_deg >= MIN_FOV_DEG and fov_deg + spread_deg <= MAX_FOV_DEG):
            raise ValueError(
                f"camera_spread.horizontal_fov_deg moves camera.horizontal_fov_deg = {fov_deg:g} out of "
                f"{MIN_FOV_DEG:g} to {MAX_FOV_DEG:g} degrees: got {spread_deg:g}"
            )
        moved_m, farthest_m = self.camera_spread.location_m, max(map(abs, self.camera.location_m))
        if moved_m and farthest_m + moved_m > FARTHEST_M:
            raise ValueError(
                f"camera_spread.location_m moves camera.location_m out of {-FARTHEST_M} to {FARTHEST_M} "
                f"metres: got {moved_m:g}"
            )
        for name, part in (("hidden_object", self.hidden_object), ("relay_wall", self.relay_wall)):
            least, most = part.least_reflectance, part.reflectance
            if least is not None and least > most:
                raise ValueError(
                    f"{name}.least_reflectance is {least:g}, above {name}.reflectance = {most:g}: it is the "
                    "lower end of the range"
                )
        divisor = gcd(self.camera.width, self.camera.height)
        if self.camera.width * self.camera.height // divisor**2 > _MOST_PROJECTOR_PIXELS:
            raise ValueError(
                f"camera.width and camera.height need a larger common divisor than {divisor}, because the "
                f"projector has an image of their aspect ratio: got {self.camera.width}x{self.camera.height}"
            )
        width, bins = self.camera.width, self.transient.bin_count
        if width * bins >= MAX_SCANLINE_VALUES:
            raise ValueError(
                f"camera.width times transient.bin_count must stay below {MAX_SCANLINE_VALUES}, the longest "
                f"scanline of an EXR file: got {width} times {bins}"
            )
        limit_hz = speed_of_light / (2 * self.transient.bin_width_m)  # Nyquist: at least two bins a period
        fastest_hz = max(self.itof.frequencies_hz)
        if fastest_hz >= limit_hz:
            raise ValueError(
                f"itof.frequencies_hz must stay below {megahertz(limit_hz)}, where a bin of "
                f"transient.bin_width_m = {self.transient.bin_width_m:g} is half a period: "
                f"got {megahertz(fastest_hz)}"
            )


def _around(ranges: list[tuple[float, float]]) -> tuple[float, float]:
    """The smallest range around some."""
    return min(low for low, _ in ranges), max(high for _, high in ranges)


def preset_from_dict(data: dict[str, Any], origin: str) -> Preset:
    """Check plain data; `origin` names the file in the message of an error.

    Raises
    ------
    PresetError : an unknown key, a wrong type or an impossible value; the message names the key.
    """
    preset: Preset = checked_data(TypeAdapter(Preset), data, origin, PresetError)
    return preset


def load_preset(name_or_file: PathLike) -> Preset:
    """Read a preset by its name in data/presets (``paper``, ``demo``, ...) or from a TOML file.

    Raises
    ------
    PresetError : there is no such preset, it is not TOML, or `preset_from_dict` refuses it.
    """
    return preset_from_dict(*read_settings("presets", name_or_file))
