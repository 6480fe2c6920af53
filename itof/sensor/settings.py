"""Settings of a camera: light source, lens, pixels, demodulation, read-out and exposure."""

from __future__ import annotations

import math
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from disk.quantities import (
    ConverterOffset,
    CosinePower,
    DutyCycle,
    ElectronRate,
    Electrons,
    ElectronsPerNumber,
    FieldOfView,
    FNumber,
    Fraction,
    Frequency,
    FullWell,
    IntegrationTime,
    Irradiance,
    LampOffset,
    PhaseSpread,
    PixelPitch,
    Power,
    RiseTime,
    Seed,
    Speed,
    SpreadOverWidth,
    TapMismatch,
    Transmitted,
    Wavelength,
    WeakDistortion,
)
from itof.radial_distortion import radial_factor, turning_square

T = TypeVar("T")
Waveform = Literal["sinusoidal", "square"]
Pixels = Annotated[int, Field(ge=1, le=2**14)]
MOST_FRAMES = 1_000_000_000


def _ascending(table: tuple[tuple[float, T], ...]) -> tuple[tuple[float, T], ...]:
    frequencies_hz = [frequency_hz for frequency_hz, _ in table]
    if frequencies_hz != sorted(set(frequencies_hz)):
        raise ValueError("the frequencies must ascend, each once")
    return table


ContrastTable = Annotated[
    tuple[tuple[Frequency, Transmitted], ...], Field(min_length=1), AfterValidator(_ascending)
]
Overtones = Annotated[tuple[Annotated[float, Field(ge=-1, le=1)], ...], Field(max_length=98)]
HarmonicsTable = Annotated[tuple[tuple[Frequency, Overtones], ...], AfterValidator(_ascending)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
class SensorSettings:
    """A camera with a two-tap pixel. The defaults are an ideal one: no noise, no limits, sinusoidal light.

    Attributes
    ----------
    width, height : sensor pixels; an image of fewer pixels is binned, by the same factor along both axes.
    horizontal_fov_deg : full field of view of lens and projector, degrees.
    emitter_power_w : mean optical power while the pixels integrate, spread over the field of view like the
        projector of the scenes, W.
    wavelength_nm : of the emitter, nm.
    ambient_w_m2 : irradiance of other light on a white wall, within the band of the camera's filter, W/m².
    f_number, lens_transmission : of the lens and the filter.
    vignetting : the light of a pixel falls with this power of the cosine of its angle to the axis; 4 for a
        simple lens.
    scattering : part of the light that the lens spreads widely over the image; scattering_width : standard
        deviation of this spread, as a part of the image width.
    distortion : k1, k2 of the lens (`itof.sensor.geometry`).
    emitter_offset_m : place of the lamp in camera axes (x right, y down, z forward), from the lens, metres.
    motion_m_s : speed of the camera along its axis, towards the wall, metres per second.
    pixel_pitch_um, fill_factor, quantum_efficiency : of a sensor pixel; electrons per photon on its area.
    crosstalk : part of the electrons of a sensor pixel that its four neighbours collect.
    full_well_e : electrons that a tap holds.
    shot_noise : whether electrons arrive one by one.
    read_noise_e : standard deviation per tap and read-out, electrons.
    dark_current_e_s : electrons per second in each tap.
    gain_spread, offset_spread_e : standard deviations of the fixed pattern: relative gain of each tap (PRNU)
        and its offset in electrons (DSNU).
    dead_pixels : part of the pixels that give nothing.
    pattern_seed : seed of the fixed pattern and of the dead pixels: another one is another sensor.
    contrast : (frequency Hz, demodulation contrast) pairs; linear in between, constant beyond. The contrast
        is the largest difference of the taps over their sum, of the emitter's light at all phases.
    emitter_waveform, reference_waveform : of the light and of the demodulation in the pixel.
    emitter_duty : part of a period in which a square emitter is on.
    rise_time_s : 0 to 100 %, of a square emitter's straight edges, seconds.
    highest_harmonic : of waveforms that are not sinusoidal.
    harmonics : (frequency Hz, harmonics of light and reference together from the second one on, over the
        first) pairs, as measured; linear in between, constant beyond. They replace those of the waveforms,
        whose higher ones stay.
    wiggling_left : part of the waveforms' error of phase and amplitude that the firmware's calibration
        leaves: 1 without a calibration, 0 with a perfect one.
    phase_steps : raw frames per frequency, at phases that divide the period evenly.
    tap_mismatch : gain of the second tap over that of the first, less 1.
    phase_drift_rad : standard deviation of a phase offset that each image has at each frequency, radians.
    adc_bits, adc_e_per_dn, adc_offset_dn : resolution of the converter, None for none; number that it gives
        for no charge.
    integration_s : integration time of a raw frame, seconds.
    frames : complete measurements that are averaged.

    Raises
    ------
    ValueError : a value out of its bounds, frequencies that do not ascend, one of the two settings of the
        converter without the other, or a distortion that folds the image.
    """

    width: Pixels = 640
    height: Pixels = 480
    horizontal_fov_deg: FieldOfView = 60.0
    emitter_power_w: Power = 1.0
    wavelength_nm: Wavelength = 850.0
    ambient_w_m2: Irradiance = 0.0
    f_number: FNumber = 1.2
    lens_transmission: Transmitted = 1.0
    vignetting: CosinePower = 0.0
    scattering: Annotated[float, Field(ge=0, lt=1)] = 0.0
    scattering_width: SpreadOverWidth = 0.2
    distortion: tuple[WeakDistortion, WeakDistortion] = (0.0, 0.0)
    emitter_offset_m: tuple[LampOffset, LampOffset, LampOffset] = (0.0, 0.0, 0.0)
    motion_m_s: Speed = 0.0
    pixel_pitch_um: PixelPitch = 10.0
    fill_factor: Transmitted = 1.0
    quantum_efficiency: Transmitted = 1.0
    crosstalk: Fraction = 0.0
    full_well_e: FullWell | None = None
    read_noise_e: Electrons = 0.0
    shot_noise: bool = False
    dark_current_e_s: ElectronRate = 0.0
    gain_spread: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    offset_spread_e: Electrons = 0.0
    dead_pixels: Annotated[float, Field(ge=0, lt=1)] = 0.0
    pattern_seed: Seed = 0
    contrast: ContrastTable = ((20e6, 1.0),)
    emitter_waveform: Waveform = "sinusoidal"
    reference_waveform: Waveform = "sinusoidal"
    emitter_duty: DutyCycle = 0.5
    rise_time_s: RiseTime = 0.0
    highest_harmonic: Annotated[int, Field(ge=1, le=99)] = 9
    harmonics: HarmonicsTable = ()
    wiggling_left: Fraction = 1.0
    phase_steps: Annotated[int, Field(ge=3, le=64)] = 4
    tap_mismatch: TapMismatch = 0.0
    phase_drift_rad: PhaseSpread = 0.0
    adc_bits: Annotated[int, Field(ge=1, le=24)] | None = None
    adc_e_per_dn: ElectronsPerNumber | None = None
    adc_offset_dn: ConverterOffset = 0.0
    integration_s: IntegrationTime = 1e-3
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)] = 1

    def __post_init__(self) -> None:
        if (self.adc_bits is None) != (self.adc_e_per_dn is None):
            raise ValueError("adc_bits and adc_e_per_dn go together: give both or neither")
        half_width = math.tan(math.radians(self.horizontal_fov_deg) / 2)
        corner = half_width * math.hypot(1, self.height / self.width)
        turning = turning_square(self.distortion)
        if turning < math.inf and corner > math.sqrt(turning) * radial_factor(turning, self.distortion):
            raise ValueError(
                f"a lens of the distortion {', '.join(f'{k:g}' for k in self.distortion)} folds the image "
                f"before the corners of a field of view of {self.horizontal_fov_deg:g} degrees: give other "
                "coefficients"
            )

    def binning(self, width: int, height: int) -> int:
        """Sensor pixels per side of a pixel of an image.

        Raises
        ------
        ValueError : the image has not the shape of the sensor, or its pixels are no whole number of the
            sensor's.
        """
        if self.width % width or self.height % height or self.width * height != self.height * width:
            raise ValueError(
                f"an image of {width}x{height} pixels is no binned image of a sensor of "
                f"{self.width}x{self.height}: its sides must divide the sensor's by the same whole number"
            )
        return self.width // width
