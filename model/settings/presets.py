"""Presets: settings of a training in TOML files."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from disk import NightError, PathLike, PresetError, inside, shipped_file
from disk.preset_files import read_layers
from itof.sensor.cameras import load_sensor
from itof.sensor.settings import SensorSettings
from model.settings.keys import merged


def training_preset(name_or_file: PathLike) -> tuple[dict[str, Any], str]:
    """Settings of a TOML file or of one in data/training, as changes of the defaults, and its path.

    A preset with the key ``extends`` begins with the settings of the preset it names, a file beside it or
    one of data/training. The key ``augmentation.camera.sensor`` names a camera of data/sensors, or a TOML
    file beside the preset, whose settings take its place.

    Raises
    ------
    PresetError : no such file, not TOML, presets that extend each other in a circle, or a camera that
        cannot be read.
    """
    layers, origins = read_layers("training", name_or_file)
    settings: dict[str, Any] = {}
    for layer in layers:
        settings = merged(settings, layer)
    sensor: Any = settings
    for key in ("augmentation", "camera", "sensor"):
        sensor = sensor.get(key) if isinstance(sensor, dict) else None
    if isinstance(sensor, str):
        camera = {"camera": {"sensor": asdict(_sensor_of(sensor, origins))}}
        settings = merged(settings, {"augmentation": camera})
    return settings, origins[0]


def _sensor_of(name: str, origins: list[str]) -> SensorSettings:
    """The camera that a preset names: a file beside it or beside one that it extends, or in data/sensors."""
    try:
        for origin in origins:
            beside = inside(Path(origin).parent, name)
            if beside.is_file():
                return load_sensor(beside)
        return load_sensor(shipped_file("sensors", name))
    except (NightError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise PresetError(f"{origins[0]}, key augmentation.camera.sensor: {reason}") from None
