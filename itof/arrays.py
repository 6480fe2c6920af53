"""Names of array types; docstrings and comments have the shapes."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# An array of numpy, torch or any other library of the array API standard. Their classes share no type.
Array: TypeAlias = Any

Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]
Phasors: TypeAlias = NDArray[np.complexfloating[Any, Any]]  # complex64 or complex128
