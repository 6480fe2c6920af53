"""The solids that explain an image, as a prediction keeps them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass as checked_dataclass

from disk.contract import STRICT
from disk.quantities import Vector
from itof import DepthMap
from itof.pictures.plan import Room
from itof.wall.expected_wall import ExpectedWall


@checked_dataclass(frozen=True, config=STRICT)
class FoundSolid:
    """A fitted solid in world axes, as ``scene.json`` describes hidden objects, with standard deviations.

    Attributes
    ----------
    rotation_std_deg : of a rotation vector in world axes; 0 for a sphere.
    size_std_m : 0 if the extents were given.
    """

    shape: str
    size_m: Vector
    location_m: Vector
    rotation_deg: Vector
    location_std_m: Vector
    rotation_std_deg: Vector
    size_std_m: Vector


@checked_dataclass(frozen=True, config=STRICT)
class Explanation:
    """What refinement has found.

    Attributes
    ----------
    solids : one or two, accepted or not.
    misfit : part of the hidden light that they do not explain, without noise.
    noise : of the measurement, as part of its hidden light.
    difference_m : of their depth map and the network's, mean over all pixels, metres.
    expected_mae_m : MAE of their depth map that the light leaves possible, metres.
    reflectance, roughness : of the solids and of the relay wall, fitted or known.
    """

    solids: tuple[FoundSolid, ...]
    accepted: bool
    misfit: float
    noise: float
    difference_m: float
    expected_mae_m: float
    reflectance: float
    roughness: float | None

    @property
    def words(self) -> str:
        """The outcome as text."""
        shapes = " and ".join(f"a {solid.shape.replace('_', ' ')}" for solid in self.solids)
        leaves = f"{'leaves' if len(self.solids) == 1 else 'leave'} {100 * self.misfit:.1f} %"
        if self.accepted:
            return f"{shapes} {leaves} of the hidden light"
        if self.noise > 1:
            return "no solid explains more than the noise"
        return f"no solid is accepted; the best, {shapes}, {leaves} of the hidden light"


@dataclass(frozen=True)
class RefinedImage:
    """Depth map (H, W), the explanation behind it if there is one, a picture of its light, and the room."""

    depth_map: DepthMap
    explanation: Explanation | None = None
    picture: Figure | None = None
    room: Room | None = None


class Refiner(Protocol):
    """Finds the solids behind a predicted depth map."""

    def __call__(
        self,
        phasor: NDArray[Any],
        prediction: DepthMap,
        expected_m: float | None,
        wall: ExpectedWall,
        horizontal_fov_deg: float,
        title: str,
    ) -> RefinedImage:
        """The better depth map of an image (H, W, F).

        `prediction` is the network's, `expected_m` the MAE that it expects of it, metres, or None; `wall` is
        that which the network was told of, `title` that of the picture.
        """
