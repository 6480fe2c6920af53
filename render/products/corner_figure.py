"""The corner of a preset as a picture: from above and from the side, with its distances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from disk import PathLike
from itof.pictures.png import save_png
from render.products.conversion import ExportError, exported_file
from scenegen import Preset
from scenegen.corner_geometry import Frustum, Points, corners_of, distances_m, lit_points, local
from scenegen.depth_range import NO_MESHES, largest_mirrored_depth_m, largest_radius_m
from scenegen.pose import wall_normal
from scenegen.sampling import projector_of, walls_of
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RELAY, _MIDDLE, _LIT, _CAMERA, _HIDDEN = "#4477aa", "#222222", "#ddaa00", "#228833", "#cc3311"
_SHOWN = 1500  # lit points
_DOTS_PER_INCH = 150


@dataclass(frozen=True)
class CornerFacts:
    """Distances in a corner, and what its camera sees; of the camera in the middle, if there are many.

    Attributes
    ----------
    camera_m, gap_m : distance of camera, and of the nearest edge of the middle wall, from the relay wall.
    region_m : smallest and largest distance of hidden objects' centres from the relay wall.
    radius_m : largest distance of a point of an object from its centre.
    farthest_m : largest distance of an object's mirror image from the camera.
    relay_wall, middle_wall, nothing : shares of the image.
    lit_m : extents of the part of the relay wall that is seen and lit: along its own x and y; 0 if none is.
    """

    camera_m: float
    gap_m: float
    region_m: tuple[float, float]
    radius_m: float
    farthest_m: float
    relay_wall: float
    middle_wall: float
    nothing: float
    lit_m: tuple[float, float]

    def as_data(self) -> dict[str, Any]:
        """The facts as plain data."""
        return asdict(self)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The facts as text."""
        shares = (f"{100 * part:.0f} %" for part in (self.relay_wall, self.middle_wall, self.nothing))
        gap = f"the gap between the walls is {self.gap_m:.2f} m wide"
        if self.gap_m < 0.005:
            gap = f"the middle wall reaches {max(-self.gap_m, 0):.2f} m behind the plane of the relay wall"
        return (
            "of the image, {} show the relay wall, {} the middle wall, {} nothing".format(*shares),
            f"the camera is {self.camera_m:z.2f} m from the relay wall",
            "{:.2f} x {:.2f} m of the relay wall are seen and lit".format(*self.lit_m),
            gap,
            "the centres of hidden objects are {:.2f} to {:.2f} m from the relay wall".format(*self.region_m),
            f"the objects reach up to {self.radius_m:.2f} m from their centres",
            f"their mirror images are at most {self.farthest_m:.2f} m from the camera",
        )


def corner_facts(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> CornerFacts:
    """Measure the corner of a preset, also one that cannot be."""
    relay, middle = walls_of(preset)
    camera = preset.camera
    view = Frustum.of_camera(camera)
    rays = view.rays()
    depths = np.stack([view.hits(relay, rays), view.hits(middle, rays)])  # (2, N)
    first, sees = depths.argmin(axis=0), np.isfinite(depths).any(axis=0)
    shares = [float((sees & (first == wall)).mean()) for wall in (0, 1)]
    lit = lit_points(camera, projector_of(preset, camera), relay, middle)
    x_m, y_m = np.ptp(local(relay, lit)[:, :2], axis=0) if len(lit) else (0.0, 0.0)
    region = distances_m(relay, _box(preset))
    return CornerFacts(
        camera_m=float(distances_m(relay, np.array([camera.location_m]))[0]),
        gap_m=float(distances_m(relay, corners_of(middle)).min()),
        region_m=(float(region.min()), float(region.max())),
        radius_m=largest_radius_m(preset, meshes),
        farthest_m=largest_mirrored_depth_m(preset, meshes),
        relay_wall=shares[0],
        middle_wall=shares[1],
        nothing=float(1 - sees.mean()),
        lit_m=(float(x_m), float(y_m)),
    )


def write_corner(preset: Preset, file: PathLike, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> CornerFacts:
    """Draw the corner of a preset from above and from the side into a PNG file.

    Raises
    ------
    ExportError : `file` is not a .png file or cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if Path(file).suffix.lower() != ".png":
        raise ExportError(f"the picture of a corner is a .png file: cannot write {file}")
    facts = corner_facts(preset, meshes)
    figure = Figure(figsize=(11, 7), layout="constrained")
    FigureCanvasAgg(figure)
    plan, side = figure.subplots(1, 2)
    across = wall_normal(walls_of(preset)[0])[:2]
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-6 else np.array([1.0, 0.0])
    draw = _Drawing(preset, facts)
    draw.view(plan, np.eye(3)[:2], "from above", ("x, m", "y, m"))
    onto = np.array([[*across, 0.0], [0.0, 0.0, 1.0]])
    draw.view(side, onto, "from the side", ("into the room, m", "z, m"))
    handles, names = plan.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle("\n".join(facts.sentences), fontsize=10)
    with exported_file(file) as partial:
        save_png(figure, partial, _DOTS_PER_INCH)
    return facts


def _box(preset: Preset, margin_m: float = 0.0) -> Points:
    """(8, 3) corners of the region of hidden objects' centres, wider by a margin."""
    place = preset.places_m
    sides = ((low - margin_m, high + margin_m) for low, high in (place.x, place.y, place.z))
    return np.array(list(product(*sides)))


@dataclass(frozen=True)
class _Drawing:
    preset: Preset
    facts: CornerFacts

    def view(self, axes: Axes, onto: NDArray[np.float64], title: str, labels: tuple[str, str]) -> None:
        """Draw everything in a projection (2, 3)."""
        relay, middle = walls_of(self.preset)
        camera, facts = self.preset.camera, self.facts
        eye, radius_m = np.array(camera.location_m), facts.radius_m
        _outline(axes, corners_of(relay) @ onto.T, _RELAY, "relay wall", width=3)
        _outline(axes, corners_of(middle) @ onto.T, _MIDDLE, "middle wall", width=3)
        _outline(axes, _box(self.preset, radius_m) @ onto.T, _HIDDEN, "reach of hidden objects", style=":")
        _outline(axes, _box(self.preset) @ onto.T, _HIDDEN, "centres of hidden objects", filled=True)
        lit = lit_points(camera, projector_of(self.preset, camera), relay, middle)
        shown = np.random.default_rng(0).permutation(lit)[:_SHOWN] @ onto.T
        axes.plot(*shown.T, ".", color=_LIT, markersize=3, label="seen and lit", zorder=3)
        rays = Frustum.of_camera(camera).corner_rays()
        reach = Frustum.of_camera(camera).hits(relay, rays)
        reach = np.where(np.isfinite(reach), reach, 2 * max(facts.camera_m, 0.5))
        seen = np.vstack([eye, eye + rays * reach[:, None]]) @ onto.T
        _outline(axes, seen, _CAMERA, "field of view", filled=True, width=0.8)
        axes.plot(*(onto @ eye), "o", color=_CAMERA, markersize=8, label="camera", zorder=5)
        self._distances(axes, onto)
        axes.set(title=title, xlabel=labels[0], ylabel=labels[1], aspect="equal")
        axes.grid(color="0.92", zorder=0)

    def _distances(self, axes: Axes, onto: NDArray[np.float64]) -> None:
        """Draw the distances of camera, middle wall and objects from the relay wall."""
        relay, middle = walls_of(self.preset)
        corners, centre = corners_of(middle), _box(self.preset).mean(axis=0)
        nearest, eye = corners[distances_m(relay, corners).argmin()], np.array(self.preset.camera.location_m)
        for place, what, above in ((eye, "", "bottom"), (nearest, "gap ", "bottom"), (centre, "", "top")):
            off_m = float(distances_m(relay, place[None])[0])
            ends = np.stack([place, place - off_m * wall_normal(relay)]) @ onto.T
            axes.plot(*ends.T, "--", color="0.4", linewidth=0.9, zorder=4)
            words = f"{what}{off_m:.2f} m"
            axes.annotate(words, ends.mean(axis=0), ha="center", va=above, fontsize=8, zorder=6)


def _outline(
    axes: Axes,
    points: Points,
    colour: str,
    name: str,
    *,
    filled: bool = False,
    style: str = "-",
    width: float = 1.5,
) -> None:
    """The convex outline of points (N, 2), which is a line if they are on one."""
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:
        far = np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()
        other = np.linalg.norm(points - points[far], axis=1).argmax()
        points = points[[far, other]]
    if filled and len(points) > 2:
        axes.fill(*points.T, color=colour, alpha=0.15, linewidth=0, zorder=1)
    axes.plot(*np.vstack([points, points[:1]]).T, style, color=colour, linewidth=width, label=name, zorder=2)
