"""The fixed pattern of a sensor: gains and offsets of its taps, and pixels that are dead.

`pattern_seed` is the sensor: the same seed gives the same pattern in every image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from itof.sensor.settings import SensorSettings

_STREAM = 0x5E11  # of random numbers, apart from that of any noise


def tap_patterns(settings: SensorSettings) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Gain and offset in electrons of either tap of every sensor pixel, (height, width) each."""
    size = (settings.height, settings.width)
    rng = np.random.default_rng([_STREAM, settings.pattern_seed, 0])
    return [
        (
            1 + settings.gain_spread * rng.standard_normal(size),
            settings.offset_spread_e * rng.standard_normal(size),
        )
        for _ in range(2)
    ]


def alive_pixels(settings: SensorSettings) -> NDArray[np.bool_]:
    """(height, width) whether a sensor pixel gives anything."""
    rng = np.random.default_rng([_STREAM, settings.pattern_seed, 1])
    alive: NDArray[np.bool_] = rng.random((settings.height, settings.width)) >= settings.dead_pixels
    return alive
