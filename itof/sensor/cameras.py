"""Cameras that come with the program or that somebody describes, as settings of `itof.sensor`."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from disk import PathLike, PresetError
from disk.contract import checked_data
from disk.preset_files import read_layers
from itof.sensor.settings import SensorSettings


def load_sensor(name_or_file: PathLike) -> SensorSettings:
    """Settings of a camera, from a name in data/sensors (``ideal``, ``mlx75027``, ...) or a TOML file.

    A file with the key ``extends`` begins with the settings of the camera that it names.

    Raises
    ------
    PresetError : there is no such file, it is not TOML, or a key or value is wrong; the message names it.
    """
    layers, origins = read_layers("sensors", name_or_file)
    data: dict[str, Any] = {key: value for layer in layers for key, value in layer.items()}
    settings: SensorSettings = checked_data(TypeAdapter(SensorSettings), data, origins[0], PresetError)
    return settings
