"""Fits of the relay wall: what both of them find, and the robust one, which judges one image.

`itof.wall.wall_phases` has the equation. The robust fit has a phase offset and a four-cycle error for each
frequency. Only the curvature of the distance over the image tells an offset from a distance, and smooth
errors bend it. So the fit needs to know how large the camera's errors may be: a camera that its maker
calibrated has offsets of about 0.1 rad (-0.1 and 0.05 rad in a file of a TI OPT8241, github lllray/tof-net).

*Weights of the robust fit.* A pixel has the weight |z|², the inverse of its phase variance under noise of
equal strength in all pixels, but at most |d|² in the same unit, so that a single bright pixel has no power.
Tukey's biweight then reduces what does not fit the wall: pixels with much hidden light, edges of the wall,
damaged pixels. docs/science/design.md (Wall found in the measurement) has the measured accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Generic

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import ArrayLike, NDArray

from itof.arrays import A, Bools, Floats, Phasors, PhasorsOf, PixelsOf
from itof.frequency_images import FrequencyImages, Slopes
from itof.light import OFFSET_STD_RAD
from itof.wall.expected_wall import ExpectedWall, NumpyWall, angle_deg, distance_m, inverse_depth_of_plane
from itof.wall.robust_solution import four_cycles_of, robust_solution
from itof.wall.turned_reference import PixelMean
from itof.wall.wall_phases import WallPhases, WallRays, four_cycles

FITS_RAD: Final = 0.5  # three times the largest residual of a valid measurement, at the edge of its wall
_LARGEST_OFFSET = 3.0  # root mean square, in standard deviations, of a camera that is what it was taken for
_LARGEST_WAVES_RAD = 0.15  # twice those of square waves
WALL_SHARE: Final = 0.9  # of the light whose phase is the wall's; 0.16 for phases at random, 1 for a wall
MOST_PIXELS: Final = 2**14  # that decide a robust fit, evenly spread: more cost time and tell nothing new
_DARK = 1e-12  # amplitude over the largest one of the image


@dataclass(frozen=True)
class WallFit(Generic[A]):
    """Wall and phases that images show; arrays of the library of the measurement.

    Attributes
    ----------
    plane_per_m : (..., 3) fitted plane m in camera axes, 1/m.
    offsets_rad : (..., F) fitted phase offsets, modulo 2π.
    wiggling_rad : (..., F, 2) fitted a_f and b_f of the four-cycle error; None if they were not fitted.
    """

    plane_per_m: A
    offsets_rad: A
    wiggling_rad: A | None

    def moved(
        self, phasor: PhasorsOf[A], wall: ExpectedWall[A], weights: Slopes[A] | None = None
    ) -> PhasorsOf[A]:
        """(..., H, W, F) complex, the direct return of the expected `wall`, moved to this wall and phases.

        It has the brightness of the expected wall.

        Parameters
        ----------
        phasor : (..., H, W, F) the images that were fitted.
        weights : `brightness_of_wall` of the images; with them, the paths within a pixel are weighted as
            `itof.weighted_reference` does.
        """
        images, pixels = wall.images, WallRays.of(wall)
        xp, size, k = images.xp, wall.meets.shape[-2:], pixels.slope[..., None]  # (F, 1, 1)
        shift_m = pixels.shift_m(pixels.depth_m(self.plane_per_m)[0])  # (..., n)
        mean = PixelMean.of(wall, xp.reshape(shift_m, (*shift_m.shape[:-1], 1, *size)), weights)
        turn = mean.shift_m * k + xp.astype(self.offsets_rad, k.dtype)[..., None, None]  # (..., F, H, W)
        if self.wiggling_rad is not None:  # the camera's error is that of the phase of a whole pixel
            rad = xp.astype(self.wiggling_rad, k.dtype)
            for place, wave in enumerate(four_cycles(FrequencyImages.of(phasor))):
                turn = turn + wave * rad[..., place, None, None]
        amplitude = mean.alpha - k**2 * mean.beta_m2
        return images.times(amplitude * xp.cos(turn), amplitude * xp.sin(turn))

    def inverse_distance_per_m(self, wall: ExpectedWall[A]) -> PixelsOf[A]:
        """(..., H, W) inverse distance of this wall along the rays to the expected one, 1/m."""
        xp, rays = wall.images.xp, WallRays.of(wall).rays
        inverse = inverse_depth_of_plane(xp.matrix_transpose(rays), self.plane_per_m)
        return xp.reshape(inverse, (*inverse.shape[:-1], *wall.rays.shape[-3:-1]))


@dataclass(frozen=True)
class RobustFit(WallFit[Floats]):
    """Outcome of `fit_wall` for one image, in numpy; axes are the camera's.

    `offsets_rad` are in [-π, π], with the mean of the four-cycle errors over the image. What these leave
    beside their mean stays in the residual, so that it can be judged.

    Attributes
    ----------
    wall : the expected wall.
    known_rad : (F,) standard deviations of the offsets that the fit started from; infinite if none are known.
    over_known : offsets, without four-cycle errors, over these: root mean square.
    plane_covariance : (3, 3) of `plane_per_m`, 1/m², with smooth errors (`itof.wall.robust_solution`).
    offsets_std_rad : (F,) standard deviations of the offsets, with smooth errors.
    shift_m : (H, W) L - L_0, metres along the ray; 0 in pixels that were not used.
    residual_rad : (H, W, F) phases that plane and offsets leave, in [-π, π]; 0 in pixels that were not used.
    weight : (H, W) weight of each pixel before Tukey's, with sum 1; 0 in pixels that were not used.
    coherence : (F,) |sum z conj(d e^{i fit})| / sqrt(sum |z|² sum |d|²) over the used pixels: 1 if z is the
        wall's return.
    mean_shift_std_m : standard deviation of the mean shift, with smooth errors.
    """

    wall: NumpyWall
    known_rad: Floats
    over_known: float
    plane_covariance: Floats
    offsets_std_rad: Floats
    shift_m: Floats
    residual_rad: Floats
    weight: Floats
    coherence: Floats
    mean_shift_std_m: float

    @property
    def distance_is_known(self) -> bool:
        """Whether there is a wall at every frequency, with offsets as small as they should be."""
        is_expected = bool(np.isfinite(self.known_rad).all())
        return self.shows_wall and is_expected and self.over_known <= _LARGEST_OFFSET

    @property
    def shows_wall(self) -> bool:
        """Whether there is a wall at every frequency."""
        return bool(self.wall_share.min() >= WALL_SHARE)

    @property
    def distance_std_m(self) -> float:
        """Standard deviation of the wall's distance along its normal, metres."""
        return plane_std(self.plane_per_m, self.plane_covariance)[0]

    @property
    def tilt_std_deg(self) -> float:
        """Root mean square angle between the true wall and the fitted one, degrees."""
        return plane_std(self.plane_per_m, self.plane_covariance)[1]

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
        return distance_m(self.plane_per_m) - distance_m(self.wall.plane_per_m)

    @property
    def tilt_deg(self) -> float:
        """Angle between the fitted and the expected wall, degrees."""
        return angle_deg(self.wall.plane_per_m, self.plane_per_m)

    @property
    def misfit_rad(self) -> Floats:
        """(F,) weighted mean of |k_f (L - L_0) + o_f|: by how much the expected phases are wrong."""
        mean: Floats = np.tensordot(self.weight, np.abs(self._wrong_rad), axes=2)
        return mean

    @property
    def mean_phase_rad(self) -> Floats:
        """(F,) the same mean with its sign."""
        mean: Floats = np.tensordot(self.weight, self._wrong_rad, axes=2)
        return mean

    @property
    def _wrong_rad(self) -> Floats:
        wrong: Floats = self.wall.slope * self.shift_m[..., None] + self.offsets_rad
        return wrong

    @property
    def misfit_std_rad(self) -> Floats:
        """(F,) standard deviation of `misfit_rad` that the residual's scatter causes."""
        unknowns = 3 + 3 * len(self.offsets_rad)
        return self.residual_rms_rad * np.sqrt(unknowns * (self.weight**2).sum())

    @property
    def fits(self) -> Bools:
        """(H, W) pixels whose residual is below `FITS_RAD` at every frequency."""
        return (self.weight > 0) & (np.abs(self.residual_rad) < FITS_RAD).all(axis=-1)

    @property
    def residual_rms_rad(self) -> Floats:
        """(F,) root of the weighted mean square of the residual over the pixels that fit, radians."""
        weight = self.weight * self.fits
        mean: Floats = np.tensordot(weight, self.residual_rad**2, axes=2) / max(weight.sum(), 1e-300)
        return np.sqrt(mean)

    @property
    def rest_rad(self) -> Floats:
        """(H, W, F) residual without the four-cycle errors that explain most of it, as a camera has them."""
        weight, rest = self.weight * self.fits, self.residual_rad.copy()
        used, slope = weight > 0, self.wall.slope
        depth_m, root = (self.wall.radial_depth_m + self.shift_m)[used], np.sqrt(weight[used])
        waves = four_cycles_of(depth_m, slope[:, None])  # (F, 2, n)
        for place, wave in enumerate(waves):
            rows = np.stack([np.ones_like(depth_m), *wave])
            found = np.linalg.lstsq((rows * root).T, rest[used, place] * root, rcond=None)[0]
            if np.hypot(*found[1:]) < _LARGEST_WAVES_RAD:
                rest[used, place] -= found @ rows
        return rest

    @property
    def wall_share(self) -> Floats:
        """(F,) share of the amplitude with a residual below `FITS_RAD`: 1 for a wall, 0.16 at random."""
        strength = np.sqrt(self.weight)
        share: Floats = np.tensordot(strength, (np.abs(self.residual_rad) < FITS_RAD) * 1.0, axes=2)
        return share / strength.sum()

    @property
    def mismatch(self) -> float:
        """1 - weighted mean cosine of the residual: 0 for a wall, 1 for phases at random."""
        return float(1 - np.tensordot(self.weight, np.cos(self.residual_rad), axes=2).mean())


def plane_std(plane_per_m: Floats, covariance: Floats) -> tuple[float, float]:
    """Standard deviation of the distance of a plane (3,) along its normal, metres, and its angle, degrees."""
    inverse_m = np.linalg.norm(plane_per_m)
    normal = plane_per_m / inverse_m
    along = float(normal @ covariance @ normal)
    across = max(float(np.trace(covariance)) - along, 0.0)
    return float(np.sqrt(max(along, 0.0)) / inverse_m**2), float(np.degrees(np.sqrt(across) / inverse_m))


def fit_wall(
    phasor: ArrayLike,
    wall: NumpyWall,
    *,
    offset_std_rad: ArrayLike = OFFSET_STD_RAD,
    start_per_m: ArrayLike | None = None,
) -> RobustFit:
    """Fit the wall's plane and the camera's phase errors to one measurement.

    Parameters
    ----------
    phasor : (H, W, F) complex, in any unit. Pixels that are 0 at some frequency are not used. For several
        images of the same corner, fit each one, or their mean.
    wall : the expected wall. Its `direct` may be a capture of the empty corner (`ExpectedWall.captured`).
    offset_std_rad : standard deviation of the phase offsets about 0, (F,) or one for all, radians, > 0;
        infinite if they may be anything. The distance is then hardly known.
    start_per_m : (3,) plane to start from; by default the expected one, which must be right to about a
        quarter of a wavelength, c / 8f. `itof.wall.wall_search.plane_from_nothing` finds another one.

    Raises
    ------
    ValueError : another shape than that of the expected wall, values that are not finite, or fewer than
        3 + F pixels with light.
    """
    z, expected = without_unit(phasor, wall), without_unit(wall.direct, wall)
    used = (z != 0).all(-1) & (expected != 0).all(-1) & np.isfinite(wall.radial_depth_m)
    count = len(wall.frequencies_hz)
    if np.count_nonzero(used) < 3 + count:
        raise ValueError(f"{np.count_nonzero(used)} pixels hold light: too few for a plane")
    z, expected = z[used], expected[used]  # (n, F)
    problem = _problem(z, expected, wall, used)
    start = wall.plane_per_m if start_per_m is None else np.asarray(start_per_m, dtype=np.float64)
    known = np.broadcast_to(np.asarray(offset_std_rad, dtype=np.float64), (count,))
    thin = problem.thinned(max(1, len(z) // MOST_PIXELS))
    plane, local, covariance = robust_solution(thin, start, known)
    # Offsets that are larger than they should be say that the rest is, too (Birge's ratio).
    over_known = float(np.sqrt(((local[:, 0] / known) ** 2).mean()))
    covariance = covariance * max(1.0, over_known**2)
    residual = problem.residual(plane, local[:, :1])
    weight = problem.weight[0]
    waves = (local[:, 1:, None] * four_cycles_of(residual.depth_m, problem.pixels.slope)).sum(axis=1)
    of_waves = waves @ weight  # their mean is an offset to all who look at the image
    left = np.angle(np.exp(1j * (residual.left - of_waves[:, None])))
    left = np.where(residual.meets, left, np.pi)  # (F, n)
    shift_m = residual.depth_m - problem.pixels.expected_depth_m
    along = problem.pixels.tangent(residual.depth_m) @ (np.sign(shift_m) * weight)  # (3,) of the mean shift
    return RobustFit(
        plane_per_m=plane,
        offsets_rad=np.angle(np.exp(1j * (local[:, 0] + of_waves))),
        wiggling_rad=None,
        wall=wall,
        known_rad=known,
        over_known=over_known,
        plane_covariance=covariance[:3, :3],
        offsets_std_rad=np.sqrt(np.maximum(np.diag(covariance)[3::3], 0.0)),
        shift_m=_image(used, shift_m),
        residual_rad=_image(used, left.T),
        weight=_image(used, weight),
        coherence=_coherence(z, expected * np.exp(1j * (problem.phases - left).T)),
        mean_shift_std_m=float(np.sqrt(max(along @ covariance[:3, :3] @ along, 0.0))),
    )


def _problem(z: Phasors, expected: Phasors, wall: NumpyWall, used: Bools) -> WallPhases[Floats]:
    """Phases of used pixels (n, F) over the expected ones, with an offset for each frequency."""
    xp = array_namespace(z)
    rays = WallRays(xp, wall.rays[used].T, used[used], wall.radial_depth_m[used], wall.slope[:, None])
    phases = (np.angle(z) - np.angle(expected)).T
    return WallPhases(xp, rays, phases, np.ones((1, 1, len(z))), pixel_weights(z, expected)[None])


def without_unit(phasor: ArrayLike, wall: NumpyWall) -> NDArray[np.complex128]:
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


def pixel_weights(phasor: Phasors, direct: Phasors) -> Floats:
    """(n,) weights of pixels (n, F), with sum 1: |z|², at most |d|² in the unit of z."""
    strength, expected = np.abs(phasor).mean(axis=-1), np.abs(direct).mean(axis=-1)
    weight = np.minimum(strength / np.median(strength / expected), expected) / expected.max()
    return weight**2 / (weight**2).sum()


def _image(used: Bools, values: Floats) -> Floats:
    image = np.zeros(used.shape + values.shape[1:])
    image[used] = values
    return image


def _coherence(z: Phasors, model: Phasors) -> Floats:
    together = np.abs((z * np.conj(model)).sum(axis=0))
    return together / np.sqrt((np.abs(z) ** 2).sum(axis=0) * (np.abs(model) ** 2).sum(axis=0))
