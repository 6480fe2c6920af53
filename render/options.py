"""The options of each rendering method, as plain data.

Each method has one frozen dataclass. Its class attributes are what other modules must know about the method
without importing it:

- `method`: name of the method, as ``--method`` takes it,
- `phasor_parts`: number of phasor images that it writes for a scene,
- `transient_fill`: size of its compressed transients divided by their raw size (notebook/rendering.md),
- `edge_divisions`: how often it divides pixels that an edge crosses.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, ClassVar, Self

from disk import NightError

# With one bounce, the only random error is that of the average over a pixel: 256 stratified paths suffice.
_ONE_BOUNCE_SPP = 256
# Divisions of a pixel that an edge crosses (render/transport/film/edge_pixels.py): the most, for errors up to
# 1 %, and the fewest, also for the mirrored scene, which has no hidden light. One less makes the error of the
# visible area 2^1.5 times as large (docs/science/renderer.md, Pixels with edges).
FINEST_EDGES, COARSEST_EDGES, _FINEST_ERROR = 7, 4, 0.01


class OptionError(NightError):
    """An option has a value that is not allowed, or the method does not have this option."""


@dataclass(frozen=True)
class ManyLightOptions:
    """Options of the method ``many-light``.

    Attributes
    ----------
    lights : number of points on the hidden surface; None takes as many as `error` needs.
    error : wanted error of the hidden phasors, relative to the hidden phasors.

    Raises
    ------
    OptionError : a value that is not above 0.
    """

    method: ClassVar[str] = "many-light"
    phasor_parts: ClassVar[int] = 3  # all light, the direct and the hidden part
    transient_fill: ClassVar[float] = 0.05  # most bins are empty
    has_only_bins: ClassVar[bool] = False

    lights: int | None = None
    error: float = 0.01

    def __post_init__(self) -> None:
        if not 0 < self.error < math.inf:
            raise OptionError(f"the hidden-signal error must be a finite number above 0, got {self.error}")
        if self.lights is not None and self.lights < 1:
            raise OptionError(f"--lights must be at least 1, got {self.lights}")

    @property
    def edge_divisions(self) -> int:
        """How often a pixel is divided where an edge crosses it.

        Less often for larger errors, so that edges have at most the share of `error` that they have at 1 %.
        """
        if self.lights is not None or self.error <= _FINEST_ERROR:
            return FINEST_EDGES
        fewer = math.floor(math.log2(self.error / _FINEST_ERROR) / 1.5 + 1e-9)
        return max(COARSEST_EDGES, FINEST_EDGES - fewer)

    def for_one_bounce(self) -> Self:
        """Options for a scene with one bounce: unchanged, because one bounce needs no lights."""
        return self


@dataclass(frozen=True)
class PathOptions:
    """Options of the method ``path``.

    Attributes
    ----------
    spp : paths per pixel.

    Raises
    ------
    OptionError : fewer than one path.
    """

    method: ClassVar[str] = "path"
    phasor_parts: ClassVar[int] = 1
    transient_fill: ClassVar[float] = 0.42  # noise fills every bin
    has_only_bins: ClassVar[bool] = True  # phasors come from bins, which need memory also without transients
    edge_divisions: ClassVar[int] = FINEST_EDGES  # it divides no pixels

    spp: int = 4096

    def __post_init__(self) -> None:
        if self.spp < 1:
            raise OptionError(f"--spp must be at least 1, got {self.spp}")

    def for_one_bounce(self) -> Self:
        """Options for a scene with one bounce: only as many paths as the average over a pixel needs."""
        return replace(self, spp=min(self.spp, _ONE_BOUNCE_SPP))


@dataclass(frozen=True)
class BatchedOptions:
    """Options of the method ``batched``, which renders phasors of many scenes at once.

    Attributes
    ----------
    error : wanted error of the hidden phasors, relative to the hidden phasors.

    Raises
    ------
    OptionError : a value that is not above 0.
    """

    method: ClassVar[str] = "batched"
    phasor_parts: ClassVar[int] = 3
    transient_fill: ClassVar[float] = ManyLightOptions.transient_fill
    has_only_bins: ClassVar[bool] = False
    edge_divisions: ClassVar[int] = FINEST_EDGES  # its edges are exact

    error: float = 0.01

    def __post_init__(self) -> None:
        self.for_other_scenes()

    def for_other_scenes(self) -> ManyLightOptions:
        """Options of ``many-light``, which renders what this method cannot."""
        return ManyLightOptions(error=self.error)

    def for_one_bounce(self) -> Self:
        """Options for a scene with one bounce: unchanged."""
        return self


MethodOptions = ManyLightOptions | PathOptions | BatchedOptions
OPTIONS: dict[str, type[MethodOptions]] = {
    made.method: made for made in (ManyLightOptions, PathOptions, BatchedOptions)
}
# A recipe lists the options of the first two methods, whichever renders. This form must not change, because a
# scene with another recipe is rendered again. Recipes of a new method list its options in addition.
_LISTED = {**asdict(PathOptions()), **asdict(ManyLightOptions())}


def recipe_options(options: MethodOptions) -> dict[str, Any]:
    """Options in the form that a recipe lists."""
    return {**_LISTED, **asdict(options)}


def options_of(method: str, given: dict[str, Any]) -> MethodOptions:
    """Options of a method from a dictionary.

    Raises
    ------
    OptionError : unknown method, an option that the method does not have, or a value that is not allowed.
    """
    own = _own_names(method)
    for name in sorted(given.keys() - own):
        owners = [other for other in OPTIONS if name in _own_names(other)]
        whose = f"an option of method {' or '.join(owners)}" if owners else "not an option of any method"
        raise OptionError(f"--{name} is {whose}, and the method is {method}: leave it out")
    return OPTIONS[method](**given)


def recorded_options(method: str, record: dict[str, Any]) -> MethodOptions:
    """Options of a method from a record, which may also list the options of other methods.

    Raises
    ------
    OptionError : unknown method, an option that no method has, or a value that is not allowed.
    """
    foreign = set(record) - option_names()
    if foreign:
        raise OptionError(f"{min(foreign)} is not an option of any method")
    own = _own_names(method)
    return options_of(method, {name: value for name, value in record.items() if name in own})


def option_names() -> set[str]:
    """Names of the options of all methods."""
    return {name for method in OPTIONS for name in _own_names(method)}


def _own_names(method: str) -> set[str]:
    if method not in OPTIONS:
        raise OptionError(f"unknown rendering method {method}: choose {' or '.join(sorted(OPTIONS))}")
    return {field.name for field in fields(OPTIONS[method])}
