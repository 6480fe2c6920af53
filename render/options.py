"""The options of each rendering method, as plain data.

A method owns its options, one frozen dataclass. The class attributes say what others must know of the
method without importing it: its name as ``--method`` takes it (`method`), how many phasor images it writes of
a scene (`phasor_parts`), and the bytes of its losslessly compressed transients by their raw bytes
(`transient_fill`, docs/performance.md).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any, ClassVar, Self

from scenegen import NightError

# One bounce has no Monte Carlo noise but the pixel's own footprint, which 256 stratified paths integrate.
_ONE_BOUNCE_SPP = 256


class OptionError(NightError):
    """An option with an impossible value, or one that the method does not have."""


@dataclass(frozen=True)
class ManyLightOptions:
    """Options of the method ``many-light``.

    Attributes
    ----------
    lights : points on the hidden surface; None to take as many as `error` needs.
    error : wanted error of the hidden phasors, relative to them.

    Raises
    ------
    OptionError : a value that is not above 0.
    """

    method: ClassVar[str] = "many-light"
    phasor_parts: ClassVar[int] = 3  # all light, the direct and the hidden part
    transient_fill: ClassVar[float] = 0.09  # most bins are empty

    lights: int | None = None
    error: float = 0.01

    def __post_init__(self) -> None:
        if not self.error > 0:
            raise OptionError(f"the hidden-signal error must be above 0, got {self.error}")
        if self.lights is not None and self.lights < 1:
            raise OptionError(f"--lights must be at least 1, got {self.lights}")

    def for_one_bounce(self) -> Self:
        """The same: one bounce needs no lights."""
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
    transient_fill: ClassVar[float] = 0.42  # noise is in every bin

    spp: int = 4096

    def __post_init__(self) -> None:
        if self.spp < 1:
            raise OptionError(f"--spp must be at least 1, got {self.spp}")

    def for_one_bounce(self) -> Self:
        """At most as many paths as the pixel's footprint needs."""
        return replace(self, spp=min(self.spp, _ONE_BOUNCE_SPP))


MethodOptions = ManyLightOptions | PathOptions
OPTIONS: dict[str, type[MethodOptions]] = {made.method: made for made in (ManyLightOptions, PathOptions)}
DEFAULT_METHOD = ManyLightOptions.method
# Recipes have listed the options of these two methods, whichever rendered, from the beginning. They keep that
# form, so that what was rendered before is not rendered again; options of another method are added to it.
_LISTED = {**asdict(PathOptions()), **asdict(ManyLightOptions())}


def recipe_options(options: MethodOptions) -> dict[str, Any]:
    """Options as a recipe lists them."""
    return {**_LISTED, **asdict(options)}


def options_of(method: str, given: dict[str, Any]) -> MethodOptions:
    """Options of a method from those that are given by name.

    Raises
    ------
    OptionError : no such method, an option that it does not have, or an impossible value.
    """
    own = _own_names(method)
    for name in sorted(given.keys() - own):
        owners = [other for other in OPTIONS if name in _own_names(other)]
        whose = f"an option of method {owners[0]}" if owners else "no option of any method"
        raise OptionError(f"--{name} is {whose}, and the method is {method}: leave it out")
    return OPTIONS[method](**given)


def recorded_options(method: str, record: dict[str, Any]) -> MethodOptions:
    """Options of a method from a record, which may list those of other methods as well.

    Raises
    ------
    OptionError : no such method, an option that no method has, or an impossible value.
    """
    foreign = set(record) - option_names()
    if foreign:
        raise OptionError(f"{min(foreign)} is no option of any method")
    own = _own_names(method)
    return options_of(method, {name: value for name, value in record.items() if name in own})


def option_names() -> set[str]:
    """Names of the options of all methods."""
    return {name for method in OPTIONS for name in _own_names(method)}


def _own_names(method: str) -> set[str]:
    if method not in OPTIONS:
        raise OptionError(f"no rendering method {method}: choose {' or '.join(sorted(OPTIONS))}")
    return {field.name for field in fields(OPTIONS[method])}
