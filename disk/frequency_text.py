"""Frequencies as text, for sentences and names of channels."""

from __future__ import annotations

from decimal import Decimal


def megahertz(*frequencies_hz: float, between: str = ", ", digits: int = 6) -> str:
    """Frequencies for a reader: ``20, 62.5 MHz``."""
    return between.join(f"{frequency_hz / 1e6:.{digits}g}" for frequency_hz in frequencies_hz) + " MHz"


def exact_megahertz(frequency_hz: float) -> str:
    """20e6 as "20", 62.5e6 as "62.5": decimal digits, which division by a float 1e6 would not keep."""
    digits = format(Decimal(repr(float(frequency_hz))).scaleb(-6), "f")
    return digits.rstrip("0").rstrip(".") if "." in digits else digits
