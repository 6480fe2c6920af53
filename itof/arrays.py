"""Types of arrays.

`PhasorsOf`, `ChannelsOf` and `PixelsOf` say the shape of an array and the kind of its numbers, and their
parameter the library: ``PhasorsOf[Array]`` for any, ``PhasorsOf[A]`` for arguments and results of the same
library and precision, and ``PhasorsOf[Complex]``, in short ``Phasors``, for numpy.
"""

from __future__ import annotations

from typing import Annotated, Any, Protocol, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray


class Array(Protocol):
    """An array of numpy, torch or any other library that supports the array API standard."""

    @property
    def dtype(self) -> object: ...  # noqa: D102
    @property
    def ndim(self) -> int: ...  # noqa: D102
    @property
    def shape(self) -> tuple[int, ...]: ...  # noqa: D102
    def __getitem__(self, key: Any, /) -> Self: ...
    def __neg__(self) -> Self: ...
    def __add__(self, other: Any, /) -> Self: ...
    def __radd__(self, other: Any, /) -> Self: ...
    def __sub__(self, other: Any, /) -> Self: ...
    def __rsub__(self, other: Any, /) -> Self: ...
    def __mul__(self, other: Any, /) -> Self: ...
    def __rmul__(self, other: Any, /) -> Self: ...
    def __truediv__(self, other: Any, /) -> Self: ...
    def __rtruediv__(self, other: Any, /) -> Self: ...
    def __pow__(self, other: Any, /) -> Self: ...
    def __matmul__(self, other: Any, /) -> Self: ...
    def __and__(self, other: Any, /) -> Self: ...
    def __or__(self, other: Any, /) -> Self: ...
    def __lt__(self, other: Any, /) -> Any: ...
    def __gt__(self, other: Any, /) -> Any: ...


A = TypeVar("A", bound=Array)
B = TypeVar("B", bound=Array)  # of another library
N = TypeVar("N", float, Array)  # a number, or an array of numbers
S = TypeVar("S", bound=np.generic)  # the number type of an array of numpy
_T = TypeVar("_T")

PhasorsOf: TypeAlias = Annotated[_T, "(..., H, W, F) complex: F frequencies of images"]
ChannelsOf: TypeAlias = Annotated[_T, "(..., C, H, W) real: C network channels of images"]
PixelsOf: TypeAlias = Annotated[_T, "(..., H, W): a number for each pixel of images"]

Complex: TypeAlias = NDArray[np.complexfloating[Any, Any]]  # complex64 or complex128
Reals: TypeAlias = NDArray[np.floating[Any]]  # float32 or float64
Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]
Numbers: TypeAlias = NDArray[np.number[Any]]
Phasors: TypeAlias = PhasorsOf[Complex]
