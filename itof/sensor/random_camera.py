"""One camera of a type: what differs from the data sheet, drawn at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from disk.quantities import TRANSMITTED
from itof.sensor.settings import SensorSettings

_CONTRAST, _RISE_TIME, _DUTY = 0.05, 0.2, 0.01  # ours: no data sheet that we know says how cameras differ


def random_camera(settings: SensorSettings, rng: np.random.Generator) -> SensorSettings:
    """A camera of this type.

    Its contrast at each frequency is within 5 % of that of the settings, its rise time within 20 %, its duty
    cycle within 0.01. Measured harmonics are as much smaller as the rise time is longer. It has a fixed
    pattern of its own, and a part, uniform between 0 and 1, of the light that the lens scatters and of the
    wiggling that the calibration leaves.
    """
    contrast = tuple(
        (f, min(max(value * rng.uniform(1 - _CONTRAST, 1 + _CONTRAST), TRANSMITTED.least), 1.0))
        for f, value in settings.contrast
    )
    pattern_seed = int(rng.integers(2**31))
    slow = rng.uniform(1 - _RISE_TIME, 1 + _RISE_TIME)
    duty = settings.emitter_duty + rng.uniform(-_DUTY, _DUTY)
    scattering, wiggling = rng.random(2)
    return replace(
        settings,
        contrast=contrast,
        pattern_seed=pattern_seed,
        rise_time_s=min(settings.rise_time_s * slow, 1e-6),
        harmonics=tuple(
            (f, tuple(max(-1.0, min(each / slow, 1.0)) for each in row)) for f, row in settings.harmonics
        ),
        emitter_duty=min(max(duty, _DUTY / 10), 1 - _DUTY / 10),
        scattering=settings.scattering * scattering,
        wiggling_left=settings.wiggling_left * wiggling,
    )
