"""The architecture of the network."""

from __future__ import annotations

from math import log2
from typing import Annotated, Final

from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import DOCUMENTED

MOST_MULTIPLE: Final = 1024  # pixels: images are enlarged to a multiple of blocks, halved at every level


@dataclass(frozen=True, config=DOCUMENTED)
class NetworkSettings:
    """Sizes of the U-Net."""

    width: Annotated[int, Field(ge=1, le=1_000_000)] = 48
    """Channels of the first level; each level has twice as many as the one before. The paper: 32."""
    levels: Annotated[int, Field(ge=1, le=8)] = 3
    """Levels of the encoder; the paper: 5."""
    negative_slope: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Slope of the ReLUs below 0. With 0, as in the paper, a long training leaves dead units
    (notebook/experiments.md)."""
    block: Annotated[int, Field(ge=0, le=64)] = 0
    """Pixels per side of a position of the U-Net; the paper: 1. 0: the power of two, at most 8, with which an
    image is about 20 positions wide."""

    def __post_init__(self) -> None:
        multiple = self.block * 2 ** (self.levels - 1)
        if multiple > MOST_MULTIPLE:
            raise ValueError(
                f"{self.levels} levels and blocks of {self.block} pixels enlarge images to multiples of "
                f"{multiple} pixels, more than {MOST_MULTIPLE}: take fewer levels or a smaller block"
            )

    def block_for(self, width: int) -> int:
        """The block for images of so many pixels: 2 for 40 pixels and 4 for 80, if it is 0.

        It is at most 8, because a position knows the details of its pixels from few features.
        """
        return self.block or 2 ** min(3, max(0, round(log2(width / 20))))
