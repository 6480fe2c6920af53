"""Refines a network's depth map: finds the solid that explains the measured hidden light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from itof import DepthMap
from itof.wall.expected_wall import ExpectedWall
from model.prediction.explanation import Explanation, FoundSolid
from model.refinement.evidence import Prior, Spread, against_nothing
from model.refinement.family import Family
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Comparison, Fit
from model.refinement.light.corner_light import CornerLight, vector
from model.refinement.search import Search
from model.refinement.settings import LARGEST_MISFIT
from model.refinement.sketch import Sketch
from model.refinement.unknowns import stretches
from scenegen.scene import HiddenObject, Scene

_COLUMNS = 40  # of the depth maps that count as evidence
_MORE_THAN_NOTHING = 50.0  # evidence that a fit needs, for its dozen unknowns and many starts


@dataclass(frozen=True)
class Refined:
    """One or two solids that explain a measurement best.

    Attributes
    ----------
    fit : the solids in their corner, with the light that was compared.
    reflectance : of the solids.
    spread : how wrong they may be.
    depth_map : mirror image of the solids.
    """

    fit: Fit
    reflectance: float
    spread: Spread
    depth_map: DepthMap

    @property
    def solids(self) -> tuple[HiddenObject, ...]:
        """In world axes; their own reflectance is 1."""
        return self.fit.candidate.hidden_objects

    @property
    def roughness(self) -> float | None:
        """Of the relay wall; None if it is Lambertian."""
        return self.fit.candidate.relay_wall.roughness

    @property
    def misfit(self) -> float:
        """Part of the hidden light that is not explained (root mean squares), without noise."""
        return self.fit.unexplained

    @property
    def noise(self) -> float:
        """Of the measurement, as part of its hidden light (root mean squares)."""
        return self.fit.comparison.noise

    def is_right(self, expected_m: float | None, *, largest_misfit: float = LARGEST_MISFIT) -> bool:
        """Whether the solids may be believed.

        They must explain the light, and more of it than chance explains of noise. Their mirror image must be
        better than the depth map of the network, as far as both can tell.

        Parameters
        ----------
        expected_m : MAE that the network expects of its depth map, metres; None if it expects none.
        largest_misfit : share of the hidden light that a solid of known extents and reflectance may leave
            unexplained; one with more unknowns must leave less (`Spread.freedom`).
        """
        limit = largest_misfit * self.spread.freedom
        explains = self.misfit <= limit and against_nothing(self.fit) > _MORE_THAN_NOTHING
        return explains and (expected_m is None or self.spread.expected_mae_m < expected_m)

    def difference_m(self, prediction: DepthMap) -> float:
        """Mean absolute difference to another depth map over all pixels; background counts as 0."""
        return float(np.abs(self.depth_map.radial_depth_m - prediction.radial_depth_m).mean())

    def explained(self, prediction: DepthMap, expected_m: float | None, largest_misfit: float) -> Explanation:
        """The solids with their uncertainty, and whether they are accepted (`is_right`)."""
        return Explanation(
            tuple(self._found(part) for part in range(len(self.solids))),
            self.is_right(expected_m, largest_misfit=largest_misfit),
            self.misfit,
            self.noise,
            self.difference_m(prediction),
            self.spread.expected_mae_m,
            self.reflectance,
            self.roughness,
        )

    def _found(self, part: int) -> FoundSolid:
        solid = self.solids[part]
        place, turn, size = (self.spread.of(kind, part) for kind in ("place", "turn", "size"))
        turn = turn if len(turn) else np.zeros(3)
        size = size @ stretches(solid.shape) if len(size) else np.zeros(3)
        return FoundSolid(
            *(solid.shape, solid.size_m, solid.location_m, solid.rotation_deg),
            *(vector(place), vector(np.degrees(turn)), vector(size * np.asarray(solid.size_m))),
        )


def refined(
    phasor: NDArray[np.complexfloating[Any, Any]],
    prediction: DepthMap,
    expected_m: float | None,
    wall: ExpectedWall,
    corner: Scene,
    light: CornerLight,
    family: Family,
    *,
    knows_camera: bool = True,
    seed: int = 0,
) -> Refined | None:
    """The solids of a family whose hidden light is that of a measurement, near the depth map of a network.

    Parameters
    ----------
    phasor : (H, W, F) complex at the frequencies of `wall`.
    prediction, expected_m : the network's depth map (H, W), and the MAE that it expects, metres, or None.
    wall : where the relay wall is expected; it may be off as far as for ``reference = "self"``.
    corner : its hidden objects do not matter.
    knows_camera : whether the camera of the corner is exactly where it was. Otherwise the measurement shows
        how far and how turned it is from the relay wall.
    light : of the corner, at the frequencies of `wall`.
    seed : of the rotations that are tried.

    Returns
    -------
    None where the prediction shows no object, or too little of the relay wall is seen.
    """
    shown_wall = without_edges(phasor, wall, corner, light, knows_camera=knows_camera)
    fine, coarse = (HiddenLight.of(shown_wall, wall, fine=fine) for fine in (True, False))
    if fine is None or coarse is None:
        return None
    close, wide = (
        Comparison(observed, corner, light, is_fine, family.reflectance, knows_camera)
        for observed, is_fine in ((fine, True), (coarse, False))
    )
    shown = (light, close.placed(corner), fine.plane_per_m, wall.rays, prediction)
    sketch = Sketch.of(*shown)
    if sketch.is_empty:
        return None
    prior = Prior.of(Sketch.of(*shown, columns=_COLUMNS), expected_m)
    search = Search(wide.as_bright(), close, sketch, prior, family)
    fits = search.fits(np.random.default_rng(seed))
    if not fits:
        return None
    comparison, candidate = fits[0].comparison, fits[0].candidate
    height, width = wall.rays.shape[:2]
    rays = wall.rays.reshape(-1, 3)
    depth_m = light.mirrored_depth_m([comparison.placed(candidate)], rays).reshape(height, width)
    depth_map = DepthMap.of_object(depth_m, depth_m > 0, prediction.frequency_hz)
    every = Sketch.of(*shown, columns=width)
    spread = Spread.of_fits(fits, prior, every, search.fitted, seed)
    return Refined(fits[0], comparison.reflectance_of(candidate), spread, depth_map)


def without_edges(
    phasor: NDArray[np.complexfloating[Any, Any]],
    wall: ExpectedWall,
    corner: Scene,
    light: CornerLight,
    *,
    knows_camera: bool = True,
) -> NDArray[np.complexfloating[Any, Any]]:
    """The phasors with 0 where a pixel may show the middle wall, too, if the corner is as it should be.

    The light itself does not tell where both walls are about as far from the camera.
    """
    observed = HiddenLight.of(phasor, wall, fine=False)
    if observed is None:
        return phasor
    placed = Comparison(observed, corner, light, False, knows_camera=knows_camera).placed(corner)
    film = wall.rays / wall.rays[..., 2:]
    wider = np.pad(film, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")  # by a pixel
    seen = light.sees_wall([placed], wider.reshape(-1, 3)).reshape(wider.shape[:2])
    whole = binary_erosion(seen, np.ones((3, 3)))[1:-1, 1:-1]
    return np.where(whole[..., None], phasor, 0)
