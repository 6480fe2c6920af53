"""Packages that only some commands need, and the extras of the installation that bring them."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
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


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """Versions of those of `packages` that are installed, by name."""
    found = {}
    for name in packages:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
