"""A camera file with the waves that captures of a wall at several distances show."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from disk import PathLike, write_text
from disk.frequency_text import megahertz
from disk.own_files import refuse_taken
from disk.preset_files import data_folder
from disk.told import Told
from itof.arrays import Floats, Phasors
from itof.capture.capture import ImageShape
from itof.capture.facts import milliradians
from itof.capture.images import read_images
from itof.capture.importing import paths
from itof.capture.sidecar import CaptureError
from itof.capture.wave_fit import WaveFit, fit_waves
from itof.light import unambiguous_range_m
from itof.sensor.cameras import load_sensor
from itof.sensor.demodulation import folded, harmonics
from itof.sensor.settings import SensorSettings
from itof.wall.finding import length
from itof.wall.unknown_wall import see_wall
from itof.wall.wall_fit import RobustFit

_LARGEST_STD_RAD: Final = 0.01  # an eighth of the phase error of square waves
_LARGEST_LEFT_RAD: Final = 0.02  # a quarter of it: then the phases hold something else
_TURNED: Final = 3.0  # standard deviations of the phase error that a turn makes


@dataclass(frozen=True, repr=False)
class CapturedWaves(Told):
    """Waves of a camera as captures of a wall show them.

    Attributes
    ----------
    base : name or file of the camera whose other settings are taken.
    before, sensor : settings of that camera, and with the waves.
    frequencies_hz : F modulation frequencies, Hz, ascending.
    fit : of the waves, in this order; images : their number.
    """

    base: str
    before: SensorSettings
    sensor: SensorSettings
    frequencies_hz: tuple[float, ...]
    fit: WaveFit
    images: int

    def phase_errors_rad(self, sensor: SensorSettings) -> Floats:
        """(F,) largest error of the phase that the waves of a camera leave, radians."""
        light = np.exp(1j * np.linspace(0, 2 * np.pi, 721))
        seen = [folded(sensor, light, each) for each in self.frequencies_hz]
        largest: Floats = np.abs(np.angle(seen / light)).max(axis=-1)
        return sensor.wiggling_left * largest

    def as_data(self) -> dict[str, Any]:
        """The result as plain data."""
        return {
            "frequencies_hz": list(self.frequencies_hz),
            "orders": list(self.fit.orders),
            "harmonics": self.fit.harmonics.tolist(),
            "phase_errors_rad": self.phase_errors_rad(self.sensor).tolist(),
            "phase_errors_std_rad": self.fit.phase_error_std.tolist(),
            "turned_rad": self.fit.turned_rad.tolist(),
            "left_rad": self.fit.left_rad.tolist(),
            "distances_m": list(self.fit.distances_m),
        }

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was seen, as text."""
        return (
            *self._warnings(),
            self._seen,
            *(
                f"at {megahertz(each)}, the phase error is {error}"
                for each, error in zip(self.frequencies_hz, self._errors(), strict=True)
            ),
        )

    @property
    def _seen(self) -> str:
        near_m, far_m = self.fit.distances_m
        left = milliradians(tuple(self.fit.left_rad.tolist()))
        return (
            f"{self.images} images of a wall at {near_m:.2f} to {far_m:.2f} m; phases that are left: {left}"
        )

    def _errors(self) -> Iterator[str]:
        errors = (self.phase_errors_rad(each) for each in (self.sensor, self.before))
        for error, before, std in zip(*errors, self.fit.phase_error_std, strict=True):
            yield f"{1e3 * error:.1f} ± {1e3 * std:.1f} mrad, instead of {1e3 * before:.1f}"

    def _warnings(self) -> Iterator[str]:
        size = np.abs(self.fit.harmonics[:, :2]).max(axis=1) * self.sensor.phase_steps
        certain = np.abs(self.fit.turned_rad) * size > _TURNED * self.fit.phase_error_std
        for each, turned in zip(
            np.array(self.frequencies_hz)[certain], self.fit.turned_rad[certain], strict=True
        ):
            yield (
                f"warning: the error at {megahertz(each)} is that of phases before an offset of "
                f"{1e3 * turned:.0f} mrad, which a camera file does not have"
            )

    def toml(self, extends: str) -> str:
        """The camera as a file that extends another."""
        highest = self.sensor.highest_harmonic
        lines = [
            "# Waves by night-eval capture waves; ± is a standard deviation.",
            f"# {self._seen}.",
            f"extends = {json.dumps(extends, ensure_ascii=False)}",
            "harmonics = [  # from the second on",
            *(
                f"    [{each!r}, {[*row]}],  # phase error {error}"
                for (each, row), error in zip(self.sensor.harmonics, self._errors(), strict=True)
            ),
            "]",
            *([f"highest_harmonic = {highest}"] if highest != self.before.highest_harmonic else []),
            *(["wiggling_left = 1.0"] if self.before.wiggling_left != 1 else []),
        ]
        return "\n".join(lines) + "\n"


def captured_waves(
    inputs: PathLike | Sequence[PathLike],
    sensor: PathLike = "mlx75027",
    *,
    horizontal_fov_deg: float | None = None,
) -> CapturedWaves:
    """Find the waves of a camera from measurement files of a flat wall at several distances.

    Parameters
    ----------
    inputs : measurement files; each may hold several images. The distances need not be known.
    sensor : name or file of the camera whose other settings are taken. Its `phase_steps` decide which
        harmonics fold into phasors; the others stay as they are.
    horizontal_fov_deg : of the images, if the files do not say it.

    Raises
    ------
    CaptureError : an image shows no wall, files differ in their frequencies, the phases hold something else
        than a wall and waves, or the distances leave the phase error uncertain by more than 10 mrad.
    MeasurementError, PresetError : a file or the camera cannot be read.
    """
    before = load_sensor(sensor)
    images, walls = _walls(paths(inputs), horizontal_fov_deg)
    fit = fit_waves(images, walls, before.phase_steps)
    frequencies_hz = walls[0].wall.frequencies_hz
    _refuse_uncertain(fit, frequencies_hz, before.phase_steps)
    table = []
    for each, seen_parts in zip(frequencies_hz, fit.harmonics.tolist(), strict=True):
        parts = harmonics(before, each) | dict(zip(fit.orders, seen_parts, strict=True))
        table.append((each, tuple(round(parts.get(h, 0.0), 4) for h in range(2, max(fit.orders) + 1))))
    highest = min(before.highest_harmonic, max(fit.orders))
    after = replace(before, harmonics=tuple(table), highest_harmonic=highest, wiggling_left=1.0)
    return CapturedWaves(str(sensor), before, after, frequencies_hz, fit, len(images))


def _walls(files: Sequence[Path], fov_deg: float | None) -> tuple[list[Phasors], list[RobustFit]]:
    """All images (H, W, F) with ascending frequencies, and their walls."""
    read = [read_images(file, shape=ImageShape(horizontal_fov_deg=fov_deg)) for file in files]
    frequencies_hz = tuple(sorted(read[0].frequencies_hz))
    for file, each in zip(files, read, strict=True):
        if tuple(sorted(each.frequencies_hz)) != frequencies_hz:
            raise CaptureError(
                f"{file} has {megahertz(*sorted(each.frequencies_hz))}, and {files[0]} "
                f"{megahertz(*frequencies_hz)}: give captures at the same frequencies"
            )
    images: list[Phasors] = []
    walls: list[RobustFit] = []
    for file, each in zip(files, read, strict=True):
        order = np.argsort(each.frequencies_hz)
        known = np.broadcast_to(each.offset_std_rad, order.shape)[order].tolist()
        for image in each.phasors[..., order]:
            found = see_wall(image, frequencies_hz, each.fov_deg, known)
            if found is None or found[1] or not found[0].shows_wall:
                raise CaptureError(f"{file} shows no flat wall: see what night-eval capture check says of it")
            images.append(image)
            walls.append(found[0])
    return images, walls


def write_captured_waves(waves: CapturedWaves, out: PathLike, *, replacing: bool = False) -> None:
    """Write the camera file, complete or not at all.

    Raises
    ------
    NightError : there is something at `out`, and it is not to be replaced; or the camera that it extends is
        a file in another folder.
    """
    refuse_taken(out, replacing=replacing)
    base, is_shipped = Path(waves.base), (data_folder("sensors") / f"{waves.base}.toml").is_file()
    own, other = Path(out).resolve(), base.resolve()
    if not is_shipped and (own == other or own.parent != other.parent):
        raise CaptureError(f"{out} extends {base}: write it beside that file, with another name")
    write_text(out, waves.toml(base.name))


def _refuse_uncertain(fit: WaveFit, frequencies_hz: Sequence[float], steps: int) -> None:
    worst = int(np.argmax(fit.left_rad))
    if fit.left_rad[worst] > _LARGEST_LEFT_RAD:
        raise CaptureError(
            f"waves of {steps} phase steps leave {1e3 * fit.left_rad[worst]:.0f} mrad of the phases at "
            f"{megahertz(frequencies_hz[worst])}: give a --sensor with the phase_steps of the camera, keep "
            "the camera still in each capture, and let a flat wall fill the image"
        )
    uncertain = fit.phase_error_std > _LARGEST_STD_RAD
    if uncertain.any():
        first = int(np.argmax(uncertain))  # the lowest frequency, with the longest period
        near_m, far_m = fit.distances_m
        period_m = float(unambiguous_range_m(frequencies_hz[first])) / steps
        over = (
            f", over at least {length(period_m)}, a period of the error" if far_m - near_m < period_m else ""
        )
        raise CaptureError(
            f"walls at {near_m:.2f} to {far_m:.2f} m leave the phase error at "
            f"{megahertz(frequencies_hz[first])} uncertain by {1e3 * fit.phase_error_std[first]:.0f} mrad: "
            f"add captures at other distances{over}"
        )
