"""Cameras that come with the program or that somebody describes, as settings of `itof.sensor`."""

from __future__ import annotations

from pydantic import TypeAdapter

from disk import PathLike, PresetError, read_settings
from disk.contract import checked_data
from itof.sensor.settings import SensorSettings


def load_sensor(name_or_file: PathLike) -> SensorSettings:
    """Settings of a camera, from a name in data/sensors (``ideal``, ``mlx75027``, ...) or a TOML file.

    Raises
    ------
    PresetError : there is no such file, it is not TOML, or a key or value is wrong; the message names it.
    """
    data, origin = read_settings("sensors", name_or_file)
    settings: SensorSettings = checked_data(TypeAdapter(SensorSettings), data, origin, PresetError)
    return settings
