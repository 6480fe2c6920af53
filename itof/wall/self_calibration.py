"""Self-calibration: the relay wall and the camera's phases as each measurement itself shows them.

`itof.wall.wall_phases` has the equation and its unknowns. The fit takes as many dimensions of the hidden
light with it as it has unknowns. A pixel has the weight |d|² of a diffuse wall in the fitted plane, the
inverse of its phase variance under noise: |d_0|² of the expected wall, even where a capture of the empty
corner gives the direct return, times (L_0 / L)^6 (`itof.wall.expected_wall.strength_elsewhere`). It does not
depend on the brightness of the measurement, so the lost dimensions are the same in every scene, and they are
those of the wall where it is, not where it was expected. Only pixels that are off by more than about 0.1 rad,
because they do not see the wall, lose their weight step by step (Tukey's biweight with a falling width, of
the frequency that fits worst).

The first steps have some hundred pixels, the last one has all. It starts so near that the gradient of the
weighted squares of all pixels is then nearly 0.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from array_api_compat import array_namespace

from itof.arrays import A, PhasorsOf
from itof.frequency_images import FrequencyImages, Slopes
from itof.other_surfaces import ELSEWHERE_RAD
from itof.wall.expected_wall import ExpectedWall, strength_elsewhere
from itof.wall.turned_reference import brightness_of_wall, weighted_path
from itof.wall.wall_fit import WallFit
from itof.wall.wall_phases import WallPhases, WallRays, Weighted, by_pixel, four_cycles, solve

# Widths of the biweight in radians, one per step; the last step has all pixels. With the first, a wall 0.4 m
# off at 60 MHz counts. With the last, a pixel with 45 mrad of hidden light has the weight 0.94; 99.9 % of
# those in the paper's have less.
_WIDTHS_RAD: Final = (2.0, 2.0, 0.7, *(ELSEWHERE_RAD,) * 3)
_FIRST_PIXELS: Final = 600  # of all steps but the last, evenly spread; about so many
_DARKEST: Final = 1e-300  # of a wall without any return, which then has no weight


def calibrate(
    phasor: PhasorsOf[A],
    wall: ExpectedWall[A],
    *,
    wiggling: bool = False,
    weights: Slopes[A] | None = None,
) -> WallFit[A]:
    """Fit plane, phase offsets and, with `wiggling`, the four-cycle error to each image.

    Parameters
    ----------
    phasor : (..., H, W, F) complex. Pixels that are 0 at some frequency are not used.
    wall : the expected wall, with arrays of the library and on the device of `phasor`; the steps start there,
        so it must be right to about c / 8f. Its `direct` may be a capture of the empty corner
        (`ExpectedWall.captured`).
    weights : `brightness_of_wall` of the images, if it is known.

    A wall of N cameras (`ExpectedWall.stacked`) is for N images (N, H, W, F), one each.

    An image that shows no wall keeps the plane and the offsets that it started with, or nearly so.
    """
    xp = array_namespace(phasor)
    problem = phases_over(phasor, wall, wiggling=wiggling, weights=weights)
    # An odd distance takes other columns in each row.
    few = problem.thinned(2 * (problem.phases.shape[-1] // (2 * _FIRST_PIXELS)) + 1)
    plane = xp.broadcast_to(xp.astype(wall.plane_per_m, xp.float64), (*phasor.shape[:-3], 3))
    steps = zip([few] * (len(_WIDTHS_RAD) - 1) + [problem], _WIDTHS_RAD, strict=True)
    schedule = [partial(_weighted, *step) for step in steps]
    plane, local = solve(plane, few.first_guess(plane), schedule)
    plane, local = (xp.where(xp.isfinite(each), each, 0.0) for each in (plane, local))
    return WallFit(plane, local[..., 0], local[..., 1:] if wiggling else None)


def phases_over(
    phasor: PhasorsOf[A], wall: ExpectedWall[A], *, wiggling: bool, weights: Slopes[A] | None = None
) -> WallPhases[A]:
    """The phases of images (..., H, W, F) over those of the expected wall, with a diffuse wall's weights."""
    images, known, pixels = FrequencyImages.of(phasor), wall.images, WallRays.of(wall)
    xp = images.xp
    alpha, path_m = weighted_path(wall, brightness_of_wall(phasor, wall) if weights is None else weights)
    phases = by_pixel(
        xp, images.phase - known.phase - path_m / alpha * pixels.slope[..., None]
    )  # (..., F, n)
    lit = by_pixel(xp, images.lit & known.lit & wall.meets)[..., None, :]  # (..., 1, n)
    strength = by_pixel(xp, xp.astype(wall.fit_strength, xp.float64))[..., None, :]  # (..., 1, n)
    strongest = xp.max(strength, axis=-1, keepdims=True)
    ones = xp.ones_like(phases[..., :1, :], dtype=xp.float64)
    basis = [ones]
    if wiggling:
        waves = [xp.astype(by_pixel(xp, wave), xp.float64) for wave in four_cycles(images)]
        basis = [xp.broadcast_to(ones, phases.shape), *waves]
    return WallPhases(
        xp,
        pixels,
        phases,
        xp.stack(basis, axis=-2),
        (strength / xp.clip(strongest, min=_DARKEST)) ** 2 * xp.astype(lit, xp.float64),
    )


def _weighted(problem: WallPhases[A], width_rad: float, plane: A, local: A) -> Weighted[A]:
    """The weights of a diffuse wall in the fitted plane, less where a pixel does not see it."""
    xp, residual = problem.xp, problem.residual(plane, local)
    farthest = xp.max(xp.abs(residual.left), axis=-2, keepdims=True)  # (..., 1, n)
    strength = strength_elsewhere(problem.pixels.expected_depth_m, residual.depth_m)[..., None, :]
    times = xp.clip(farthest / width_rad, max=1.0)
    share = (1 - times * times) * strength
    return problem, residual, problem.weight * (share * share), None
