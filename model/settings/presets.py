"""Presets: settings of a training in TOML files."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from disk import NightError, PathLike, PresetError, inside, read_settings, shipped_file
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
    layers: list[dict[str, Any]] = []
    origins: list[str] = []
    name: PathLike | None = name_or_file
    while name is not None:
        data, origin = _read_layer(name, origins)
        if origin in origins:
            raise PresetError(f"{' extends '.join([*origins, origin])}: a circle has no beginning")
        origins.append(origin)
        name = _extended(data.pop("extends", None), Path(origin))
        layers.append(data)
    settings: dict[str, Any] = {}
    for layer in reversed(layers):
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


def _read_layer(name: PathLike, origins: list[str]) -> tuple[dict[str, Any], str]:
    """Settings of one file, and its path; an error also names the file in `origins` that extends it."""
    try:
        return read_settings("training", name)
    except PresetError as error:
        if not origins:
            raise
        raise PresetError(f"{origins[-1]}, key extends: {error}") from None


def _extended(name: object, origin: Path) -> PathLike | None:
    """The preset that the file `origin` extends: a file beside it, or a name in data/training."""
    if name is None:
        return None
    try:
        beside = inside(origin.parent, str(name))
        return beside if beside.is_file() else shipped_file("training", str(name))
    except (NightError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise PresetError(f"{origin}, key extends: {reason}") from None
