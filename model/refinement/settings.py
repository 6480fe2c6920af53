"""Options of the refinement, as plain data."""

from __future__ import annotations

from typing import Final, Literal

Unknown = Literal["sizes", "reflectance"]  # what of the object may be fitted besides its pose
UNKNOWNS: tuple[Unknown, ...] = ("sizes", "reflectance")
LARGEST_MISFIT: Final = 0.01  # of the comparable hidden light may stay unexplained
