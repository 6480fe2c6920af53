"""Preset files: TOML, found by path or by name among the files that come with the program."""

from __future__ import annotations

import os
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

from disk.inner_paths import inside
from disk.night_error import NightError
from disk.path_like import PathLike
from disk.plain_file import read_text


class PresetError(NightError):
    """A preset that is missing, cannot be read, or asks for something impossible."""


def read_settings(kind: str, name_or_file: PathLike) -> tuple[dict[str, Any], str]:
    """Read a TOML file, given by its path or by its name in data/<kind>.

    Parameters
    ----------
    kind : folder of data/: ``presets`` (datasets), ``training``, ``sensors`` or ``captures``.
    name_or_file : name without ``.toml``, or a path.

    Returns
    -------
    The contents as plain data, and the path of the file.

    Raises
    ------
    PresetError : there is no such file, or it is not TOML.
    """
    named = _shipped(kind)
    file = named.get(os.fspath(name_or_file), Path(name_or_file))
    try:
        return tomllib.loads(read_text(file)), str(file)
    except (FileNotFoundError, IsADirectoryError):
        raise PresetError(
            f"no preset {name_or_file}: give a .toml file or one of {', '.join(sorted(named))}"
        ) from None
    except OSError as error:
        raise PresetError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeError as error:
        raise PresetError(f"{file} cannot be read: {error}") from None
    except (ValueError, RecursionError) as error:  # also numbers too long, and tables too deep
        raise PresetError(f"{file} cannot be read as TOML: {error}") from None


def read_layers(kind: str, name_or_file: PathLike) -> tuple[list[dict[str, Any]], list[str]]:
    """Contents of a TOML file, after those of the files that it extends; and their paths, its own first.

    The key ``extends`` names the file whose contents come before those of its own: one beside it, or one of
    data/<kind>. Parameters are those of `read_settings`.

    Raises
    ------
    PresetError : no such file, not TOML, or files that extend each other in a circle.
    """
    layers: list[dict[str, Any]] = []
    origins: list[str] = []
    name: PathLike | None = name_or_file
    while name is not None:
        data, origin = _read_layer(kind, name, origins)
        if origin in origins:
            raise PresetError(f"{' extends '.join([*origins, origin])}: a circle has no beginning")
        origins.append(origin)
        name = _extended(kind, data.pop("extends", None), Path(origin))
        layers.insert(0, data)
    return layers, origins


def _read_layer(kind: str, name: PathLike, origins: list[str]) -> tuple[dict[str, Any], str]:
    """Contents of one file, and its path; an error also names the file in `origins` that extends it."""
    try:
        return read_settings(kind, name)
    except PresetError as error:
        if not origins:
            raise
        raise PresetError(f"{origins[-1]}, key extends: {error}") from None


def _extended(kind: str, name: object, origin: Path) -> PathLike | None:
    """What the file `origin` extends: a file beside it, or a name in data/<kind>."""
    if name is None:
        return None
    try:
        beside = inside(origin.parent, str(name))
        return beside if beside.is_file() else shipped_file(kind, str(name))
    except (NightError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise PresetError(f"{origin}, key extends: {reason}") from None


def shipped_file(kind: str, name: str) -> Path:
    """Path of the file in data/<kind> with this name, for names that stand in a file of a stranger.

    Raises
    ------
    PresetError : there is no such file. One in the current folder is not looked for.
    """
    named = _shipped(kind)
    if name not in named:
        raise PresetError(f"there is no {name}: those that come with NIGHT are {', '.join(named)}")
    return named[name]


def _shipped(kind: str) -> dict[str, Path]:
    return {file.stem: file for file in sorted(data_folder(kind).glob("*.toml"))}


def data_folder(kind: str) -> Path:
    """Path of data/<kind>, the files that come with the program: in the source tree, else as installed."""
    source = Path(__file__).parent.parent / "data" / kind
    return source if source.is_dir() else Path(sysconfig.get_path("data")) / "share" / "night" / kind
