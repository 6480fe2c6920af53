"""The direct return of a wall that is a little elsewhere, from that of the expected wall.

The light of a pixel comes over different paths, which cancel in part. With the gradient g of log reference
within the pixel and its second derivatives h, the mean over a pixel is 1 + (g · g + sum h) / 24 of the value
in the middle. A wall that is elsewhere changes both. In addition, a wall whose brightness has the gradient s
changes the mean by 1 + s · g / 12 (`itof.weighted_reference`). With k_f = 4π f / c, the imaginary part of g
is k_f times the gradient of the distance L, and its real part is nearly the same at all frequencies. So both
changes together are those of an amplitude, α - k_f² β, and of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Final, Generic

from itof.arrays import A, PhasorsOf, PixelsOf
from itof.frequency_images import FrequencyImages, Slopes, dot, part, slope_and_bend
from itof.wall.expected_wall import ExpectedWall
from itof.weighted_reference import brightness_slopes

_STEEPEST: Final = 0.5  # radians per pixel; a larger step of the phase is the edge of the wall


@dataclass(frozen=True)
class PixelMean(Generic[A]):
    """Mean over a pixel of a moved wall, over the mean of the expected one; arrays (..., 1 or F, H, W).

    Attributes
    ----------
    shift_m : change of the distance that has the mean phase, metres.
    alpha, beta_m2 : α and β of the amplitude α - k_f² β.
    """

    shift_m: A
    alpha: A | float
    beta_m2: A

    @classmethod
    def of(
        cls, wall: ExpectedWall[A], shift_m: PixelsOf[A], weights: Slopes[A] | None = None
    ) -> PixelMean[A]:
        """Of a wall that is `shift_m` (..., 1, H, W) farther; with the gradient `weights` of its brightness.

        Derivatives are 0 in images too small for them, and where they are those of an edge.
        """
        xp, slopes_m, bends_m = wall.images.xp, *_derivatives(wall.images.xp, shift_m)
        limits_m = [_STEEPEST / slope for slope in wall.slope.tolist()]
        largest_m = max(float(xp.max(xp.abs(each))) for each in (*slopes_m, *bends_m))
        if largest_m < min(limits_m):
            turn_m, square_m2 = _change(wall, slopes_m, bends_m)
        else:
            changes = [_change(wall, *_below(xp, limit_m, slopes_m, bends_m)) for limit_m in limits_m]
            turn_m, square_m2 = (xp.concat(each, axis=-3) for each in zip(*changes, strict=True))
        if weights is None:
            return cls(shift_m + turn_m, 1.0, square_m2)
        depth_m = wall.slopes[1]
        there_m = (depth_m[0] + slopes_m[0], depth_m[1] + slopes_m[1])
        alpha, path_m = weighted_path(wall, weights, there_m)
        return cls(shift_m + turn_m + path_m / alpha, alpha, alpha * square_m2 - path_m * path_m / 2)


def brightness_of_wall(phasor: PhasorsOf[A], wall: ExpectedWall[A]) -> Slopes[A]:
    """(..., 1, H, W) gradient s of the log brightness of the wall that images (..., H, W, F) show."""
    first = FrequencyImages.of(phasor[..., :1])
    return brightness_slopes(wall.images.first, first)


def weighted_path(
    wall: ExpectedWall[A], weights: Slopes[A], slopes_m: Slopes[A] | None = None
) -> tuple[A, A]:
    """Real part of 1 + s · g / 12, and its imaginary part over k_f, metres; both (..., 1, H, W).

    `slopes_m` is the gradient of the distance, by default of the expected one.
    """
    log_amplitude, depth_m = wall.slopes
    return 1 + dot(weights, log_amplitude) / 12, dot(weights, slopes_m or depth_m) / 12


def _change(wall: ExpectedWall[A], slopes_m: Slopes[A], bends_m: Slopes[A]) -> tuple[A, A]:
    """What a shift with these derivatives adds to (g · g + sum h) / 24.

    First the imaginary part over k_f, metres, then minus the real part over k_f², square metres.
    """
    log_amplitude, depth_m = wall.slopes
    both_m = (2 * depth_m[0] + slopes_m[0], 2 * depth_m[1] + slopes_m[1])
    return dot(slopes_m, log_amplitude) / 12 + (bends_m[0] + bends_m[1]) / 24, dot(slopes_m, both_m) / 24


def _below(
    xp: ModuleType, limit_m: float, slopes_m: Slopes[A], bends_m: Slopes[A]
) -> tuple[Slopes[A], Slopes[A]]:
    """Derivatives along an axis where both are below a limit, else 0."""

    def chosen(slope_m: A, bend_m: A) -> tuple[A, A]:
        smooth = xp.maximum(xp.abs(slope_m), xp.abs(bend_m)) < limit_m
        return xp.where(smooth, slope_m, 0.0), xp.where(smooth, bend_m, 0.0)

    (across, bend_across), (down, bend_down) = map(chosen, slopes_m, bends_m)
    return (across, down), (bend_across, bend_down)


def _derivatives(xp: ModuleType, values: A) -> tuple[Slopes[A], Slopes[A]]:
    """First and second derivatives per pixel; 0 along an axis that is too short for them."""

    def along(axis: int) -> tuple[A, A]:
        if values.shape[axis] < 3:
            return xp.zeros_like(values), xp.zeros_like(values)
        return slope_and_bend(xp, part(values, axis, 1, None) - part(values, axis, None, -1), axis)

    (across, bend_across), (down, bend_down) = along(-1), along(-2)
    return (across, down), (bend_across, bend_down)
