"""Harmonics of a camera's waves, from images of a flat wall at several distances.

With N phase steps, light of the phase φ is measured as S exp(j φ) W(φ), where the harmonics C_h that fold
into the phasor (`itof.sensor.demodulation`) make

    W(φ) = 1 + C_{N+1} exp(j N φ) + C_{N-1} exp(-j N φ) + C_{2N+1} exp(2j N φ) + C_{2N-1} exp(-2j N φ).

For image i, pixel p and frequency f, φ = k_f L + o_f with k_f = 4π f / c. The distance L = 1 / (m_i · r_p)
follows from the plane m_i of the wall, so nobody needs to measure it. Unknown are the planes, an offset o_f
and a gain of each frequency, and the harmonics. They follow by least squares from arg z, and from log |z|
without its mean over the frequencies, in which brightness and exposure cancel. The difference
C_{N+1} - C_{N-1} makes the error of the phase; their sum needs two frequencies.

A camera may turn its phases after they were measured. Then W depends on φ + δ_f. So the coefficients of
exp(±j N φ) are fitted as complex numbers, whose phases give δ_f: the smallest one of those that differ by
π / N, which changes signs of the harmonics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from itof.arrays import Floats, Phasors
from itof.light import phase_per_metre
from itof.wall.wall_fit import RobustFit

_BLOCKS: Final = (12, 16)  # rows and columns of means, in which noise averages out and waves do not
_SMOOTH_RAD: Final = 3e-3  # error of an image at a frequency that is smooth over it: `robust_solution`
_HIGHEST: Final = 99  # harmonic of a camera file


@dataclass(frozen=True)
class WaveFit:
    """What images of a wall show of the waves.

    Attributes
    ----------
    orders : (M,) the harmonics that fold.
    harmonics : (F, M) over the first one.
    phase_error_std : (F,) standard deviation of C_{N+1} - C_{N-1}, that is of the phase error, radians.
    turned_rad : (F,) δ_f.
    left_rad : (F,) root mean square of the phases that are left.
    distances_m : (nearest, farthest) distance along the rays.
    """

    orders: tuple[int, ...]
    harmonics: Floats
    phase_error_std: Floats
    turned_rad: Floats
    left_rad: Floats
    distances_m: tuple[float, float]


def fit_waves(images: Sequence[Phasors], walls: Sequence[RobustFit], steps: int) -> WaveFit:
    """Fit planes, offsets, gains and harmonics to images (H, W, F) of one camera.

    Parameters
    ----------
    walls : of the images, from which the planes start; they say which pixels see the wall.
    steps : N, at least 3.
    """
    means = [_means(image, wall) for image, wall in zip(images, walls, strict=True)]
    problem = _Problem(
        rays=np.concatenate([rays for rays, _, _ in means]),
        log_ratio=np.log(np.concatenate([ratio for _, ratio, _ in means])),
        image=np.repeat(np.arange(len(means)), [len(rays) for rays, _, _ in means]),
        expected_m=np.concatenate([depth_m for _, _, depth_m in means]),
        slope=2 * phase_per_metre(walls[0].wall.frequencies_hz),
        cycles=np.array([n for n in (steps, -steps, 2 * steps, -2 * steps) if abs(n) < _HIGHEST]),
    )
    start = np.concatenate([*[wall.plane_per_m for wall in walls], np.zeros(problem.others)])
    found = least_squares(problem.residual, start, x_scale="jac", method="trf")
    left = found.fun.reshape(-1)[: problem.phases].reshape(-1, len(problem.slope))
    left_rad = np.sqrt((left**2).sum(axis=0) / len(walls))
    variance = float((left_rad**2).mean()) + _SMOOTH_RAD**2
    covariance = np.linalg.pinv(found.jac.T @ found.jac, rcond=1e-12, hermitian=True) * variance
    planes, _, _, waves = problem.unknowns(found.x)
    depth_m = 1 / (planes[problem.image] * problem.rays).sum(axis=-1)
    plus, minus = waves[:, 0], waves[:, 1]
    beta = np.angle(minus**2 + plus.conj() ** 2) / 2  # N δ
    turn = np.exp(1j * beta)[:, None] ** (problem.cycles / steps)
    return WaveFit(
        orders=tuple(int(abs(1 + n)) for n in problem.cycles),
        harmonics=(waves * turn).real,
        phase_error_std=problem.std_of_difference(covariance, beta),
        turned_rad=beta / steps,
        left_rad=left_rad,
        distances_m=(float(depth_m.min()), float(depth_m.max())),
    )


def _means(image: Phasors, wall: RobustFit) -> tuple[Floats, NDArray[np.complex128], Floats]:
    """Rays (n, 3), phasors over the expected ones (n, F), and expected distances (n,): means of blocks."""
    direct = np.asarray(wall.wall.direct)
    used = wall.fits & (image != 0).all(axis=-1)
    places = [np.arange(size) * count // size for size, count in zip(used.shape, _BLOCKS, strict=True)]
    block = (places[0][:, None] * _BLOCKS[1] + places[1])[used]

    def mean(values: Floats) -> Floats:
        summed = np.stack([np.bincount(block, each, np.prod(_BLOCKS)) for each in values.T], axis=-1)
        return summed[count > 0] / count[count > 0, None]

    count = np.bincount(block, minlength=int(np.prod(_BLOCKS)))
    ratio = image[used] / direct[used]
    ratio /= np.abs(ratio).mean()
    rays = mean(np.asarray(wall.wall.rays)[used])
    return rays, mean(ratio.real) + 1j * mean(ratio.imag), 1 / (rays @ wall.wall.plane_per_m)


@dataclass(frozen=True)
class _Problem:
    """Means of all images, as a problem of least squares. `image` (n,) is the place of each."""

    rays: Floats
    log_ratio: NDArray[np.complex128]
    image: NDArray[np.int_]
    expected_m: Floats
    slope: Floats
    cycles: NDArray[np.int_]

    @property
    def phases(self) -> int:
        return self.log_ratio.size

    @property
    def others(self) -> int:
        """Number of the unknowns beside the planes."""
        return len(self.slope) * (2 + 2 * len(self.cycles))

    def unknowns(self, x: Floats) -> tuple[Floats, Floats, Floats, NDArray[np.complex128]]:
        """Planes (I, 3), offsets (F,), logarithms of gains (F,), coefficients of the `cycles` (F, M)."""
        frequencies = len(self.slope)
        planes, rest = np.split(x, [len(x) - self.others])
        offsets, gains, waves = np.split(rest, [frequencies, 2 * frequencies])
        re, im = waves.reshape(2, frequencies, -1)
        return planes.reshape(-1, 3), offsets, gains, re + 1j * im

    def residual(self, x: Floats) -> Floats:
        """Phases, amplitudes, and the harmonics, which are at most about those of squares."""
        planes, offsets, gains, waves = self.unknowns(x)
        depth_m = 1 / (planes[self.image] * self.rays).sum(axis=-1)
        phase = self.slope * depth_m[:, None] + offsets  # (n, F)
        wave = 1 + (waves * np.exp(1j * phase[..., None] * self.cycles)).sum(axis=-1)
        left = self.log_ratio - np.log(wave) - gains
        turn = left.imag - self.slope * (depth_m - self.expected_m)[:, None] - offsets
        size = left.real - left.real.mean(axis=-1, keepdims=True)
        root = 1 / np.sqrt(np.bincount(self.image))[self.image, None]
        known = _SMOOTH_RAD * np.abs(1 + self.cycles) ** 2 * waves
        rows = (np.angle(np.exp(1j * turn)) * root, size * root, known.real, known.imag)
        return np.concatenate([row.reshape(-1) for row in rows])

    def std_of_difference(self, covariance: Floats, beta: Floats) -> Floats:
        """(F,) of C_{N+1} - C_{N-1}, for phases `beta` (F,) of the coefficients."""
        found = []
        for place, angle in enumerate(beta):
            re, im = np.zeros((2, len(self.slope), len(self.cycles)))
            re[place, :2], im[place, :2] = np.cos(angle) * np.array([1, -1]), -np.sin(angle)
            row = np.concatenate([np.zeros(len(covariance) - 2 * re.size), re.ravel(), im.ravel()])
            found.append(np.sqrt(row @ covariance @ row))
        return np.array(found)
