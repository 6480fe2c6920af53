"""What a camera leaves of the hidden light of scenes, before a network is trained for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf
from typing import Final

import numpy as np

from itof import read_image
from itof.arrays import Phasors
from itof.sensor.binned import BinnedCamera
from itof.sensor.scene_camera import hidden_snr
from itof.sensor.settings import MOST_FRAMES, SensorSettings
from scenegen import MEASUREMENT_FILE, Dataset

_SCENES: Final = 8
_NOTHING: Final = 1e-9  # of hidden light over noise
# With 1.9, `night-80x60-camera` has 2.6 cm instead of 2.0 (docs/guide/cameras.md, How long to expose).
_ENOUGH: Final = 2.0
# With 3 %, a network that knows no camera has twice its error, with four times that it sees little (the same
# page, What the waves do: 16 and 8 phase steps without a calibration).
_MUCH: Final = 0.1


@dataclass(frozen=True)
class CameraLight:
    """The hidden light behind a camera.

    Attributes
    ----------
    snr : hidden light over noise, in a component of a pixel, with one exposure; infinite without noise.
    changed : root mean square of what the waves change of the hidden light in spite of a capture of the empty
        corner, over its own.
    """

    snr: float
    changed: float

    @property
    def sentence(self) -> str:
        """What it means for a network, as text without a full stop."""
        noise = "has no noise" if self.snr == inf else f"leaves {self.snr:.2g} of hidden light / noise"
        if self.snr < _ENOUGH:
            noise += ", too little for a good image"
            count = (_ENOUGH / max(self.snr, _NOTHING)) ** 2
            if count <= MOST_FRAMES:
                noise += f": average {ceil(count)} exposures ({ceil(count)} times the frames)"
        waves = f"its waves change {100 * self.changed:.2g} % of the hidden light"
        if self.changed > _MUCH:
            waves += ", much for a network: calibrate them (wiggling_left), or take more phase_steps"
        return f"this camera {noise}; {waves}"


def camera_light(dataset: Dataset, sensor: SensorSettings) -> CameraLight:
    """What the camera `sensor` leaves of the hidden light of a dataset's first validation scenes."""
    seen = [read_image(dataset.render_folder(scene) / MEASUREMENT_FILE) for scene in _some(dataset)]
    hz = dataset.preset.itof.frequencies_hz
    images = [(image.phasors("direct")[0], image.phasors("hidden")[0]) for image in seen]
    return light_behind(replace(sensor, phase_drift_rad=0.0), images, hz)


def light_behind(
    sensor: SensorSettings, images: list[tuple[Phasors, Phasors]], frequencies_hz: tuple[float, ...]
) -> CameraLight:
    """The same for images (H, W, F) of the direct and of the hidden light."""
    height, width = images[0][0].shape[:2]
    camera = BinnedCamera(sensor, frequencies_hz, width, height)
    snr, change, size = [], 0.0, 0.0
    for direct, hidden in images:
        snr.append(hidden_snr(camera, direct + hidden, hidden)[0])
        empty = camera.mean(direct)
        lit = (np.abs(direct) > 0) & (np.abs(empty) > 0)
        true, found = hidden[lit] / direct[lit], camera.mean(direct + hidden)[lit] / empty[lit] - 1
        change += float((np.abs(found - true) ** 2).sum())
        size += float((np.abs(true) ** 2).sum())
    return CameraLight(float(np.mean(snr)), float(np.sqrt(change / size)) if size else 0.0)


def _some(dataset: Dataset) -> list[str]:
    return list(dataset.ids("validation"))[:_SCENES]
