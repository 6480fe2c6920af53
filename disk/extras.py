"""Packages that only some commands need, and the extras of the installation that bring them."""

from __future__ import annotations

from importlib.util import find_spec

from disk.night_error import NightError


class MissingPackageError(NightError):
    """A package that an optional part of NIGHT needs is not installed."""


def need(extra: str, packages: tuple[str, ...], purpose: str) -> None:
    """`MissingPackageError` unless all `packages`, which `extra` installs, are there for `purpose`."""
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        words = f"the package{'s' if len(missing) > 1 else ''} {', '.join(missing)}"
        raise MissingPackageError(f"{purpose} needs {words}: pip install 'night-nlos[{extra}]'")
