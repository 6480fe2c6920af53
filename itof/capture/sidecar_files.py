"""Sidecars as TOML files, of known formats and of the user."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter

from disk import PathLike, PresetError, read_settings, shipped_file
from disk.contract import checked_data
from itof.capture.sidecar import CaptureError, Sidecar

KIND: Final = "captures"  # folder of data/


def load_sidecar(name_or_file: PathLike, changes: Sequence[str] = ()) -> tuple[Sidecar, Path]:
    """The sidecar of a name in data/captures (``espros``, ...) or of a TOML file, and the folder it is in.

    Parameters
    ----------
    name_or_file : a file may have the key ``format``, the name of one in data/captures whose keys it changes.
    changes : further keys, each as a line of TOML like ``horizontal_fov_deg = 60.0``.

    Raises
    ------
    CaptureError : a key or value is wrong or missing; the message names it.
    PresetError : there is no such file, or it is not TOML.
    """
    data, origin = read_settings(KIND, name_or_file)
    base = data.pop("format", None)
    if base is not None:
        if not isinstance(base, str) or Path(base).name != base or base.endswith(".toml"):
            raise CaptureError(
                f"{origin}: format must be the name of a format in data/captures, got {base!r}"
            )
        try:
            data = {**read_settings(KIND, shipped_file(KIND, base))[0], **data}
        except PresetError as error:
            raise CaptureError(f"{origin}, key format: {error}") from None
    for change in changes:
        data |= _changed(change)
    sidecar: Sidecar = checked_data(TypeAdapter(Sidecar), data, origin, CaptureError)
    return sidecar, Path(origin).parent


def _changed(line: str) -> Mapping[str, Any]:
    try:
        return tomllib.loads(line)
    except (ValueError, RecursionError) as error:
        raise CaptureError(
            f"{line!r} is no line of TOML ({error}); write it like 'horizontal_fov_deg = 60.0'"
        ) from None
