"""The relay wall as the phases of a measurement show it: a fit of its plane and of phase offsets.

All but 0.2 % of the light of a pixel comes straight from the relay wall. The phase of the phasor z_f over the
wall's expected direct return d_f is therefore small and smooth:

    arg(z_f conj d_f) = k_f (L - L_0) + o_f + hidden light + noise,   k_f = 4π f / c

L is the wall's distance along the ray r of a pixel, and L_0 the expected one. For a plane, 1 / L = m · r is
linear in the three numbers m, and dL = -L² r · dm. With an offset o_f for each frequency, 3 + F unknowns
follow from H W F phases in closed form. The step is repeated (Gauss-Newton) until it is negligible.

*Weights.* A pixel has the weight |z|², the inverse of its phase variance under noise of equal strength in all
pixels, but at most |d|² in the same unit, so that a single bright pixel has no power. Tukey's biweight then
reduces what does not fit the wall: pixels with much hidden light, edges of the wall, damaged pixels.
docs/science/design.md (Wall found in the measurement) has the measured accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from itof.wall.expected_wall import ExpectedWall
from itof.wall.plane_phases import PlanePhases, wrapped

Floats = NDArray[np.float64]

FITS_RAD = 0.5  # three times the largest residual of a valid measurement, at the edge of its wall
_DARK = 1e-12  # amplitude over the largest one of the image


@dataclass(frozen=True)
class WallFit:
    """Outcome of `fit_wall`; axes are the camera's.

    Attributes
    ----------
    plane_per_m : (3,) fitted plane m, 1/m.
    expected_plane_per_m : (3,) the plane that was expected.
    offsets_rad : (F,) fitted phase offsets in [-π, π]; 0 if they were not fitted.
    slope : (F,) k_f, rad per metre of depth.
    shift_m : (H, W) L - L_0, metres along the ray; 0 in pixels that were not used.
    residual_rad : (H, W, F) phases that the fit leaves, in [-π, π]; 0 in pixels that were not used.
    weight : (H, W) weight of each pixel before Tukey's, with sum 1; 0 in pixels that were not used.
    coherence : (F,) |sum z conj(d e^{i fit})| / sqrt(sum |z|² sum |d|²) over the used pixels: 1 if z is the
        wall's return.
    mean_shift_std_m : standard deviation of the mean shift that the residual's scatter causes. Hidden light
        is no scatter: its bias comes on top.
    offsets_std_rad : (F,) the same for the offsets; 0 if they were not fitted.
    """

    plane_per_m: Floats
    expected_plane_per_m: Floats
    offsets_rad: Floats
    slope: Floats
    shift_m: Floats
    residual_rad: Floats
    weight: Floats
    coherence: Floats
    mean_shift_std_m: float
    offsets_std_rad: Floats

    @property
    def mean_shift_m(self) -> float:
        """Weighted mean of |L - L_0| over the pixels, metres along the ray."""
        return float((self.weight * np.abs(self.shift_m)).sum())

    @property
    def max_shift_m(self) -> float:
        """Largest |L - L_0| of a pixel, metres along the ray."""
        return float(np.abs(self.shift_m).max())

    @property
    def distance_shift_m(self) -> float:
        """Change of the wall's distance from the camera, metres along its normal; > 0: farther away."""
        before, after = (np.linalg.norm(m) for m in (self.expected_plane_per_m, self.plane_per_m))
        return float(1 / after - 1 / before)

    @property
    def tilt_deg(self) -> float:
        """Angle between the fitted and the expected wall, degrees."""
        one, other = self.expected_plane_per_m, self.plane_per_m
        # by its tangent: the cosine of a small angle has no digits left
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))

    @property
    def misfit_rad(self) -> Floats:
        """(F,) weighted mean of |k_f (L - L_0) + o_f|: by how much the expected phases are wrong."""
        total = self.slope * self.shift_m[..., None] + self.offsets_rad
        mean: Floats = np.tensordot(self.weight, np.abs(total), axes=2)
        return mean

    @property
    def misfit_std_rad(self) -> Floats:
        """(F,) standard deviation of `misfit_rad` that the residual's scatter causes."""
        unknowns = 3 + np.count_nonzero(self.offsets_rad)
        return self.residual_rms_rad * np.sqrt(unknowns * (self.weight**2).sum())

    @property
    def fits(self) -> NDArray[np.bool_]:
        """(H, W) pixels whose residual is below `FITS_RAD` at every frequency."""
        return (self.weight > 0) & (np.abs(self.residual_rad) < FITS_RAD).all(axis=-1)

    @property
    def residual_rms_rad(self) -> Floats:
        """(F,) root of the weighted mean square of the residual over the pixels that fit, radians."""
        weight = self.weight * self.fits
        mean: Floats = np.tensordot(weight, self.residual_rad**2, axes=2) / max(weight.sum(), 1e-300)
        return np.sqrt(mean)

    @property
    def wall_share(self) -> Floats:
        """(F,) share of the amplitude with a residual below `FITS_RAD`: 1 for a wall, 0.16 at random."""
        strength = np.sqrt(self.weight)
        share: Floats = np.tensordot(strength, (np.abs(self.residual_rad) < FITS_RAD) * 1.0, axes=2)
        return share / strength.sum()


def fit_wall(
    phasor: ArrayLike,
    wall: ExpectedWall,
    *,
    offsets: bool = False,
    start_per_m: ArrayLike | None = None,
    direct: ArrayLike | None = None,
) -> WallFit:
    """Fit the wall's plane and, with `offsets`, a phase offset for each frequency to one measurement.

    Parameters
    ----------
    phasor : (H, W, F) complex, in any unit. Pixels that are 0 at some frequency are not used. For several
        images of the same corner, fit each one, or their mean.
    wall : the expected wall.
    offsets : whether to fit phase offsets. Only differences of distance between pixels tell an offset from
        a distance, so noise counts ten times as much; with one frequency it is hardly possible.
    start_per_m : (3,) plane to start from; by default the expected one, which must be right to about a
        quarter of a wavelength, c / 8f. `itof.wall.wall_search.plane_from_nothing` finds another one.
    direct : (H, W, F) complex, a measured direct return that replaces ``wall.direct``.

    Raises
    ------
    ValueError : another shape than that of the expected wall, values that are not finite, or fewer than
        3 + F pixels with light.
    """
    z = without_unit(phasor, wall)
    known = without_unit(wall.direct if direct is None else direct, wall)
    used = (z != 0).all(-1) & (known != 0).all(-1) & np.isfinite(wall.radial_depth_m)
    if np.count_nonzero(used) < 3 + len(wall.frequencies_hz):
        raise ValueError(f"{np.count_nonzero(used)} pixels hold light: too few for a plane")
    weight = pixel_weights(z[used], known[used])  # (n,)
    phases = np.angle(z[used]) - np.angle(known[used])  # (n, F)
    problem = PlanePhases(phases, wall.rays[used], wall.radial_depth_m[used], weight, wall.slope, offsets)
    start = wall.plane_per_m if start_per_m is None else np.asarray(start_per_m, dtype=np.float64)
    plane, offset, covariance = problem.thinned().solve(start)
    residual, tangent, depth_m = problem.residual(plane, offset)
    shift_m = np.where(np.isfinite(depth_m), depth_m - wall.radial_depth_m[used], 0.0)
    along = np.sign(shift_m) * weight @ tangent  # (3,) derivative of the mean shift
    fitted = known[used] * np.exp(1j * (phases - residual))
    return WallFit(
        plane_per_m=plane,
        expected_plane_per_m=wall.plane_per_m,
        offsets_rad=wrapped(offset),
        slope=wall.slope,
        shift_m=_image(used, shift_m),
        residual_rad=_image(used, residual),
        weight=_image(used, weight),
        coherence=_coherence(z[used], fitted),
        mean_shift_std_m=float(np.sqrt(max(along @ covariance[:3, :3] @ along, 0.0))),
        offsets_std_rad=np.sqrt(np.maximum(np.diag(covariance)[3:], 0.0)) if offsets else 0 * offset,
    )


def without_unit(phasor: ArrayLike, wall: ExpectedWall) -> NDArray[np.complex128]:
    """(H, W, F) phasors whose largest component is 1; those a million million times smaller are 0.

    Amplitudes of such an image can be squared and divided without overflow.

    Raises
    ------
    ValueError : another shape than that of the expected wall, or values that are not finite.
    """
    z = np.asarray(phasor)
    if z.shape != wall.direct.shape:
        raise ValueError(f"expected phasors of shape {wall.direct.shape}, got {z.shape}")
    if not np.isfinite(z).all():
        raise ValueError("the phasors hold NaN or infinite values")
    components = np.ascontiguousarray(z, dtype=np.complex128).view(np.float64)
    largest = np.abs(components).max(initial=0.0)
    scaled = (components / (largest or 1.0)).view(np.complex128)
    return np.where(np.abs(scaled) < _DARK, 0.0, scaled)


def pixel_weights(phasor: NDArray[Any], direct: NDArray[Any]) -> Floats:
    """(n,) weights of pixels (n, F), with sum 1: |z|², at most |d|² in the unit of z."""
    strength, expected = np.abs(phasor).mean(axis=-1), np.abs(direct).mean(axis=-1)
    weight = np.minimum(strength / np.median(strength / expected), expected) / expected.max()
    return weight**2 / (weight**2).sum()


def _image(used: NDArray[np.bool_], values: Floats) -> Floats:
    image = np.zeros(used.shape + values.shape[1:])
    image[used] = values
    return image


def _coherence(z: NDArray[Any], model: NDArray[Any]) -> Floats:
    together = np.abs((z * np.conj(model)).sum(axis=0))
    return together / np.sqrt((np.abs(z) ** 2).sum(axis=0) * (np.abs(model) ** 2).sum(axis=0))
