"""Imperfections of a camera by name, each with the settings that switch it off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from itof.sensor.settings import SensorSettings

PERFECT: Final[dict[str, dict[str, Any]]] = {
    "shot noise": {"shot_noise": False},
    "dark noise": {"read_noise_e": 0.0, "dark_current_e_s": 0.0},
    "ambient light": {"ambient_w_m2": 0.0},
    "converter": {"adc_bits": None, "adc_e_per_dn": None},
    "full well": {"full_well_e": None},
    "fixed pattern": {"gain_spread": 0.0, "offset_spread_e": 0.0, "dead_pixels": 0.0, "tap_mismatch": 0.0},
    "wiggling": {"emitter_waveform": "sinusoidal", "reference_waveform": "sinusoidal", "harmonics": ()},
    "vignetting": {"vignetting": 0.0},
    "scattering": {"scattering": 0.0},
    "crosstalk": {"crosstalk": 0.0},
    "distortion": {"distortion": (0.0, 0.0)},
    "lamp beside the lens": {"emitter_offset_m": (0.0, 0.0, 0.0)},
    "motion": {"motion_m_s": 0.0},
    "drift": {"phase_drift_rad": 0.0},
}


def without(settings: SensorSettings, *names: str) -> SensorSettings:
    """The camera without the imperfections of these names in `PERFECT`."""
    for name in names:
        settings = replace(settings, **PERFECT[name])
    return settings


def cameras_by_imperfection(settings: SensorSettings) -> Iterator[tuple[str, SensorSettings]]:
    """The whole camera, a perfect one, and for each imperfection: one with it alone, and one without it."""
    perfect = without(settings, *PERFECT)
    yield "all", settings
    yield "none", perfect
    for name, keys in PERFECT.items():
        alone = replace(perfect, **{key: getattr(settings, key) for key in keys})
        if alone != perfect:
            yield f"{name} alone", alone
            yield f"all but {name}", without(settings, name)
