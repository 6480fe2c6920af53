"""What makes a prediction from a measurement doubtful, as plain data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that makes a prediction from a measurement doubtful.

    Attributes
    ----------
    code : the kind of finding, for programs:
        ``no-wall`` (the light is not that of a wall), ``convention`` (sign, order, axes or frequency),
        ``no-hidden-light`` (too coarse, or of one depth image),
        ``wall-moved``, ``other-view`` (another field of view), ``phase-offsets``, ``scatter``,
        ``no-capture`` (of the empty corner), ``strange-pixels``, ``dead-pixels``, ``even-amplitude``,
        ``saturated``,
        ``unexplained`` (light that a prediction does not explain).
    sentence : the same for a reader, without a capital letter and a full stop.
    refused : whether predictions from such a measurement are useless; otherwise they are worse.
    """

    code: str
    sentence: str
    refused: bool


def length(metres: float) -> str:
    """A length as text, in a unit that suits it: ``0.1 mm``, ``5.0 cm``, ``2.25 m``."""
    if metres >= 0.9995:
        return f"{metres:.2f} m"
    return f"{100 * metres:.1f} cm" if metres >= 0.01 else f"{1000 * metres:.1f} mm"
