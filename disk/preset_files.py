"""Preset files: TOML, found by path or by name among the files that come with the program."""

from __future__ import annotations

import os
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

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
