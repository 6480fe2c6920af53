"""The preset of a real corner, from a capture of its empty relay wall.

The phases show the plane of the wall in the camera's axes: its distance and two angles. They do not show
where along the wall the camera stands, nor how it is turned about the wall's normal. So the wall has the pose
of the preset ``paper``, where it is plumb; the rows of the image are horizontal, or rolled by a known angle;
and middle wall and hidden region are those of that preset. The image of an empty wall does not show the
middle wall: the camera stands where its image ends beside the edge of that wall, as in that preset, and its
middle shows the same height of the relay wall.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from textwrap import wrap
from typing import Any, Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from disk import NightError, PathLike, write_text
from disk.own_files import refuse_taken
from disk.quantities import Vector
from itof.arrays import Floats
from itof.capture.capture import ImageShape
from itof.capture.image_check import ImageCheck, check_image
from itof.capture.images import CapturedImages, read_images
from itof.capture.importing import paths
from itof.wall.empty_corner import LARGEST_TILT_DEG
from itof.wall.expected_wall import distance_m
from itof.wall.finding import length
from itof.wall.wall_fit import RobustFit
from scenegen import Preset, preset_from_dict
from scenegen.corner_geometry import Frustum, corners_of, distances_m
from scenegen.pose import camera_axes
from scenegen.sampling import walls_of
from scenegen.scene import Wall

Side = Literal["left", "right"]
_LARGEST_STD_M: Final = 0.1  # of the distance; it hardly matters: itof.wall.empty_corner
_MOST_TURN_DEG: Final = 80.0  # from straight towards the wall; beyond, the middle of the image shows none
_OTHER_PLANE: Final = ("wall-range", "not-flat")  # warnings that say that the plane may be another
_STEP_M: Final = 1e-5  # of differences of the plane, whose phases are smooth
_MOST_SIDEWAYS: Final = 4.0  # of rays, per metre; beyond, they go along the wall
_LEAST_ASIDE_M: Final = 0.1  # of the camera, from the plane of the middle wall
_BEHIND_CAMERA_M: Final = 1.0  # how far the middle wall reaches beyond the camera, at least


class CapturedCornerError(NightError):
    """A capture that shows no wall."""


@dataclass(frozen=True)
class CapturedCorner:
    """A preset, and how well the capture shows what is in it.

    Attributes
    ----------
    preset : the corner; the rest is that of the preset ``paper``.
    source : name of the capture.
    hidden : side of the hidden region, for someone who looks at the wall.
    place : (3,) distance of the camera from the wall, metres; angles of its axis from straight towards the
        wall, to the right and up, degrees.
    std : (3,) their standard deviations.
    doubts : why the wall's place is not certain; empty if it is.
    """

    preset: Preset
    source: str
    hidden: Side
    place: Vector
    std: Vector
    doubts: tuple[str, ...]

    def as_data(self) -> dict[str, Any]:
        """What was seen as plain data."""
        names = ("distance_m", "right_deg", "up_deg")
        seen = dict(zip(names, self.place, strict=True))
        std = {name.replace("_", "_std_"): each for name, each in zip(names, self.std, strict=True)}
        return {**seen, **std, "hidden": self.hidden, "doubts": list(self.doubts)}

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was seen, and what was assumed, as text."""
        (away_m, right_deg, up_deg), std = self.place, self.std
        to = (
            f"{abs(right_deg):.2f} ± {std[1]:.2f} degrees to the {'left' if right_deg < 0 else 'right'} and "
            f"{abs(up_deg):.2f} ± {std[2]:.2f} {'down' if up_deg < 0 else 'up'}"
        )
        seen = f"the wall is {length(away_m)} ± {length(std[0])} away, and the camera is turned {to}"
        assumed = f"middle wall and hidden region are the paper's, to the {self.hidden}"
        return (
            f"seen: {seen} from straight towards it",
            "assumed: the wall is plumb, and the rows of the image are horizontal but for --roll",
            f"assumed: {assumed}; the image ends beside the middle wall, which --aside changes",
        )

    @property
    def toml(self) -> str:
        """The preset as a file, without the keys that are as in ``paper``."""
        camera, middle, region = self.preset.camera, self.preset.middle_wall, self.preset.hidden_object
        away_m, aside_deg, up_deg = self.std
        name = "".join(c if c.isprintable() else "?" for c in self.source)  # TOML has no control characters
        texts = [
            f"The corner in {name}, by night-eval capture corner; ± is a standard deviation.",
            *(f"{text[0].upper()}{text[1:]}." for text in self.sentences),
            "Measure what is assumed, and change it here; night-gen corner draws it.",
        ]
        lines = [
            *(
                line
                for text in texts
                for line in wrap(text, 110, initial_indent="# ", subsequent_indent="# ")
            ),
            "\n[camera]",
            f"width = {camera.width}",
            f"height = {camera.height}",
            f"horizontal_fov_deg = {camera.horizontal_fov_deg!r}",
            f"location_m = {_numbers(camera.location_m)}  # x ± {away_m:.3f}; y and z are assumed",
            f"rotation_deg = {_numbers(camera.rotation_deg)}  # ± {up_deg:.2f} up, ± {aside_deg:.2f} aside",
            "\n[itof]",
            f"frequencies_hz = {_numbers(self.preset.itof.frequencies_hz)}",
            f"\n[relay_wall]\nsize_m = {_numbers(self.preset.relay_wall.size_m)}  # assumed",
            "\n[middle_wall]  # assumed",
            *(
                f"{key} = {_numbers(getattr(middle, key))}"
                for key in ("size_m", "location_m", "rotation_deg")
            ),
            "\n[hidden_object.location_m]  # assumed",
            *(f"{axis} = {_numbers(getattr(region.location_m, axis))}" for axis in "xyz"),
        ]
        return "\n".join(lines) + "\n"


def captured_corner(
    inputs: PathLike | Sequence[PathLike],
    sidecar: PathLike | None = None,
    *,
    changes: Sequence[str] = (),
    bin_side: int | None = None,
    size: tuple[int, int] | None = None,
    horizontal_fov_deg: float | None = None,
    hidden: Side | None = None,
    gap_m: float | None = None,
    aside_m: float | None = None,
    roll_deg: float = 0.0,
    progress: bool = True,
) -> CapturedCorner:
    """Find the corner whose empty wall a capture shows.

    Parameters that are not listed are those of `itof.check_capture`.

    Parameters
    ----------
    inputs : raw frames with a `sidecar`, or a measurement file with one image; if it has a ``reference``,
        this is the empty wall.
    hidden : side of the hidden region, for someone who looks at the wall; by default the one to which the
        camera is turned.
    gap_m : distance of the middle wall's edge from the relay wall, metres.
    aside_m : distance of the camera from the plane of the middle wall, metres.
    roll_deg : turn of the camera about its axis, clockwise for someone behind it, degrees.

    Raises
    ------
    CapturedCornerError : there are several images, or they show no wall where the camera looks.
    CaptureError, MeasurementError : as `itof.check_capture`.
    """
    shape = ImageShape(bin_side, size, horizontal_fov_deg)
    images = read_images(inputs, sidecar, shape=shape, changes=changes, progress=progress)
    source = paths(inputs)[0].name
    check = _checked(images, source)
    if check.fit is None or any(each.code == "no-wall" for each in check.findings):
        found = "; ".join(each.sentence for each in check.findings)
        raise CapturedCornerError(f"{source} shows no wall: {found}")
    fit = check.fit
    place = _place(fit.plane_per_m, roll_deg)
    if np.linalg.norm(place[1:]) > _MOST_TURN_DEG:
        raise CapturedCornerError(
            f"{source} shows a wall {np.linalg.norm(place[1:]):.0f} degrees beside the camera's axis: turn "
            f"the camera towards the wall, by less than {_MOST_TURN_DEG:g} degrees"
        )
    side: Side = hidden or ("left" if place[1] < 0 else "right")
    height, width = images.phasors.shape[1:3]
    axes = _camera_axes(fit.plane_per_m, roll_deg)
    view = Frustum((0.0, 0.0, 0.0), _rotation_deg(axes), images.fov_deg, width, height)
    tables = _corner(view, axes[2], float(place[0]), side, gap_m, aside_m)
    tables["itof"] = {"frequencies_hz": sorted(images.frequencies_hz)}
    preset = preset_from_dict(tables, source)
    std = _vector(_std_of_place(fit, roll_deg))
    return CapturedCorner(preset, source, side, _vector(place), std, tuple(_doubts(check, fit)))


def write_captured_corner(corner: CapturedCorner, out: PathLike, *, replacing: bool = False) -> None:
    """Write the preset, complete or not at all.

    Raises
    ------
    NightError : there is something at `out`, and it is not to be replaced.
    """
    refuse_taken(out, replacing=replacing)
    write_text(out, corner.toml)


def _checked(images: CapturedImages, source: str) -> ImageCheck:
    """What the image of the empty wall shows."""
    wall, facts = images.reference, images.reference_facts
    if wall is None:
        if len(images.phasors) != 1:
            raise CapturedCornerError(
                f"{source} holds {len(images.phasors)} images: give a file with one, of the empty wall"
            )
        wall, facts = images.phasors[0], images.facts
    return check_image(wall, images.frequencies_hz, images.fov_deg, facts, images.offset_std_rad)


def _doubts(check: ImageCheck, fit: RobustFit) -> Iterator[str]:
    """Why the wall may be elsewhere. Light of the wall alone is no fault here."""
    for finding in check.findings:
        if finding.code in _OTHER_PLANE or (finding.refused and finding.code != "no-hidden-light"):
            yield finding.sentence
    if not fit.distance_is_known or fit.distance_std_m > _LARGEST_STD_M:
        yield (
            f"the wall's distance is uncertain by {length(fit.distance_std_m)} or more, because the phase "
            "offsets of the camera are large or unknown: write them into the sidecar, or measure the distance"
        )
    if fit.tilt_std_deg > LARGEST_TILT_DEG:
        yield (
            f"the wall's angle is uncertain by {fit.tilt_std_deg:.1f} degrees: capture more frames, or more "
            "of the wall"
        )


def _camera_axes(plane_per_m: Floats, roll_deg: float) -> Floats:
    """(3, 3) the camera's right, down and forward as rows, in world axes where the wall faces +x."""
    normal = -plane_per_m / np.linalg.norm(plane_per_m)  # in camera axes, towards the camera
    roll = np.radians(roll_deg)
    image_up = np.array([-np.sin(roll), -np.cos(roll), 0.0])
    # Upwards is perpendicular to the normal, and goes along image_up in the image.
    up = -normal[2] * image_up + (image_up @ normal) * np.array([0.0, 0.0, 1.0])
    up /= np.linalg.norm(up)
    axes: Floats = np.column_stack([normal, -np.cross(normal, up), up])
    return axes


def _place(plane_per_m: Floats, roll_deg: float) -> Floats:
    """(3,) distance, and angles of the camera's axis to the right and up, as of `CapturedCorner`."""
    x, y, z = _camera_axes(plane_per_m, roll_deg)[2]
    angles = np.degrees([np.arctan2(y, -x), np.arcsin(np.clip(z, -1, 1))])
    return np.array([distance_m(plane_per_m), *angles])


def _std_of_place(fit: RobustFit, roll_deg: float) -> Floats:
    """(3,) standard deviations of `_place`, from those of the plane."""
    step_per_m = _STEP_M / distance_m(fit.plane_per_m) ** 2
    ends = [
        [_place(fit.plane_per_m + sign * step, roll_deg) for sign in (1, -1)]
        for step in step_per_m * np.eye(3)
    ]
    slope = np.array([(plus - minus) / (2 * step_per_m) for plus, minus in ends])  # (3 of the plane, 3)
    std: Floats = np.sqrt(np.einsum("ik,ij,jk->k", slope, fit.plane_covariance, slope))
    return std


def _rotation_deg(axes: Floats) -> Vector:
    """Euler angles of a Blender camera, which looks along its own -z."""
    right, down, forward = axes
    turn = Rotation.from_matrix(np.column_stack([right, -down, -forward]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # rolled by 90 degrees: one of the angles is free
        x, y, z = _rounded(turn.as_euler("xyz", degrees=True), 3)
    return (x, y, z)


def _corner(
    view: Frustum, forward: Floats, away_m: float, side: Side, gap_m: float | None, aside_m: float | None
) -> dict[str, dict[str, Any]]:
    """Tables of a preset: the paper's corner, mirrored for the left side, with the camera `away_m` off."""
    paper, sign = Preset(), 1 if side == "right" else -1
    relay, middle = walls_of(paper)
    eye, ahead = np.array(paper.camera.location_m), camera_axes(paper.camera)[2]
    own_gap_m = float(distances_m(relay, corners_of(middle)).min())
    gap_m = own_gap_m if gap_m is None else gap_m
    if aside_m is None:  # the outermost ray passes the edge of the middle wall at the same distance
        beside_m = own_gap_m - eye[0] + abs(eye[1]) / _sideways(Frustum.of_camera(paper.camera), 1)
        aside_m = max((away_m - gap_m + beside_m) * _sideways(view, sign), _LEAST_ASIDE_M)
    height_m = eye[2] - ahead[2] * eye[0] / ahead[0]  # in the middle of the image, on the wall at x = 0
    place = [away_m, -sign * aside_m, height_m + forward[2] * away_m / forward[0]]
    long_m = round(max(middle.size_m[0], away_m + _BEHIND_CAMERA_M - gap_m), 2)
    region = asdict(paper.hidden_object.location_m)
    return {
        "camera": {
            "location_m": _rounded(place, 4),
            "rotation_deg": view.rotation_deg,
            "horizontal_fov_deg": view.horizontal_fov_deg,
            "width": view.width,
            "height": view.height,
        },
        "relay_wall": {"size_m": _large_enough(relay, view, place)},
        "middle_wall": {
            "size_m": [long_m, middle.size_m[1]],
            "location_m": _rounded([gap_m + long_m / 2, *middle.location_m[1:]], 4),
            "rotation_deg": _rounded([sign * middle.rotation_deg[0], *middle.rotation_deg[1:]], 3),
        },
        "hidden_object": {"location_m": region | {"y": sorted(sign * end for end in region["y"])}},
    }


def _large_enough(relay: Wall, view: Frustum, place: Sequence[float]) -> list[float]:
    """Height and width of the relay wall at x = 0, at least those of the paper: it fills the image."""
    rays = view.corner_rays()
    towards = rays[rays[:, 0] < 0]
    sideways = np.clip(towards[:, 1:] / -towards[:, :1], -_MOST_SIDEWAYS, _MOST_SIDEWAYS)
    far_m = np.abs(np.array(place[1:]) - relay.location_m[1:] + sideways * place[0]).max(axis=0)  # y, z
    return [max(size, float(math.ceil(2 * far))) for size, far in zip(relay.size_m, far_m[::-1], strict=True)]


def _sideways(view: Frustum, sign: int) -> float:
    """How far rays of an image go to +y or -y for each metre on their way to the wall at x = 0, at most."""
    rays = view.corner_rays()
    towards = rays[rays[:, 0] < 0]
    return float(np.clip((sign * towards[:, 1] / -towards[:, 0]).max(), 0, _MOST_SIDEWAYS))


def _vector(values: Floats) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def _rounded(values: Sequence[float] | Floats, digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]  # without a negative zero


def _numbers(values: Sequence[float]) -> str:
    return f"[{', '.join(map(repr, map(float, values)))}]"
