"""Cameras that come with the program or that somebody describes, as settings of `itof.sensor`."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import TypeAdapter

from itof.sensor.demodulation import wiggling
from itof.sensor.settings import SensorSettings
from scenegen import Dataset, PathLike, PresetError, read_settings
from scenegen.contract import checked_data

_SAME_DEG = 1e-6


def load_sensor(name_or_file: PathLike) -> SensorSettings:
    """Settings of a camera, from a name in data/sensors (``ideal``, ``mlx75027``, ...) or a TOML file.

    Raises
    ------
    PresetError : there is no such file, it is not TOML, or a key or value is wrong; the message names it.
    """
    data, origin = read_settings("sensors", name_or_file)
    settings: SensorSettings = checked_data(TypeAdapter(SensorSettings), data, origin, PresetError)
    return settings


def view_problem(
    settings: SensorSettings, dataset: Dataset, width: int, height: int, frequencies_hz: Sequence[float]
) -> str | None:
    """Why this camera cannot measure the images (W x H) of a dataset at these frequencies, Hz, as a sentence.

    None if it can.
    """
    if dataset.preset.camera_spread.horizontal_fov_deg:
        return f"the scenes of {dataset.root} have different fields of view, and a camera has one"
    fov_deg = dataset.preset.camera.horizontal_fov_deg
    if abs(fov_deg - settings.horizontal_fov_deg) > _SAME_DEG:
        return (
            f"the camera sees {settings.horizontal_fov_deg:g} degrees and the scenes of {dataset.root} are "
            f"rendered for {fov_deg:g}: set horizontal_fov_deg of the camera to that"
        )
    try:
        settings.binning(width, height)
        if settings.wiggling_left < 1:
            for frequency_hz in frequencies_hz:
                wiggling(settings, frequency_hz)
    except ValueError as error:
        return f"the camera cannot measure {dataset.root}: {error}"
    return None
