"""Captures and sidecars that cannot be used: each is refused in one sentence."""

import pickle

import h5py
import numpy as np
import pytest
from captures import IMAGES, TAPS, raw_of, read_here, sidecar_of, steps, taps_of, without, write_sidecar
from night_commands import refusal
from scipy.io import savemat
from scipy.io.matlab import MatlabObject
from wall_measurements import wall_of_plane

from disk import PresetError
from itof import phase
from itof.capture.capture import capture_of
from itof.capture.demodulating import sensor_pixels
from itof.capture.sidecar import CaptureError
from itof.capture.sidecar_files import load_sidecar
from itof.files.array_claims import RefusedError

PHASOR = wall_of_plane().direct
RAW = np.round(1000 * taps_of(PHASOR, steps(4), steps(2)))[None]  # (N, H, W, F, S, T)
PHASE = phase(PHASOR)


def changed(place, value):
    spoilt = RAW.copy()
    spoilt[place] = value
    return spoilt


ALL = (slice(None),) * 3  # frames, rows, columns
FRAMES = {
    "frame 1 is 3 times as bright as frame 0: frames of mixed exposure": np.concatenate([RAW, 3 * RAW]),
    "frame 1 holds no light: a dark frame?": np.concatenate([RAW, np.full_like(RAW, 3)]),
    "has 2 values on the axis frequency, and the sidecar says 3: a missing frequency": RAW[:, :, :, :2],
    "every number at 50 MHz is 0: a missing frequency?": changed((*ALL, 1), 0),
    "tap 1 does not change with the light at 20 MHz: is it stuck": changed((..., 1), 77),
    "tap 0 does not change with the light at 60 MHz": changed((*ALL, 2, slice(None), 0), 500),
    "all pixels are saturated: capture with a shorter exposure": np.maximum(RAW, 4095),
    "8-bit numbers are too coarse": (RAW / RAW.max() * 255).astype(np.uint8),
    "holds 2e+30, and 1e+30 is the most: write it in another unit": changed((0, 0, 0, 0), 2e30),
    "holds at most 1.186e-197, which is too small: write it in another unit": RAW * 1e-200,
    "holds 1248 values that are NaN or infinite (11 %): if": changed((0, slice(2)), np.nan),
    "has the shape (18, 26), which does not fit the axes": RAW[0, ..., 0, 0, 0],
    "has no array raw; it holds nothing": None,
    "is empty: capture again": RAW[:0],
    "every number at 20 MHz is 5": np.full_like(RAW, 5),
}


@pytest.mark.parametrize("words", FRAMES)
def test_frames_that_cannot_be_right_are_refused(tmp_path, words):
    sidecar = sidecar_of(tmp_path, bits=12)
    arrays = {} if FRAMES[words] is None else {"raw": FRAMES[words]}
    with pytest.raises(CaptureError) as refused:
        capture_of(raw_of(sidecar, **arrays), sidecar)
    assert words in str(refused.value)


def test_arrays_that_lack_an_axis_and_images_without_light_are_refused(tmp_path):
    sidecar = sidecar_of(tmp_path, axes=["row", "column", "step", "tap"])
    words = r"^frames\.npz: the array raw has the size 1 on the axis frequency, not 3: a missing frequency"
    with pytest.raises(CaptureError, match=words):
        raw_of(sidecar, raw=RAW[0, :, :, 0])
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors", arrays=["re"], imaginary_arrays=["im"])
    frames = np.stack([PHASOR, 0 * PHASOR])
    with pytest.raises(CaptureError, match="frame 1 holds no light"):
        capture_of(raw_of(sidecar, re=frames.real, im=frames.imag), sidecar)


PHASES = {"layout": "amplitude-phase", "arrays": ["p"], "amplitude_arrays": ["a"]}
DEPTHS = PHASES | {"layout": "amplitude-depth"}
UNITS = {
    "more than one period (6.28319): correct phase_unit; degrees": (PHASES, np.degrees(PHASE)),
    "of 360 degrees: correct phase_unit; radians?": (PHASES | {"phase_unit": "deg"}, PHASE),
    "4096 dn, more than one period (2048)": (
        PHASES | {"phase_unit": "dn", "phase_period_dn": 2048.0},
        np.where(PHASE > 3, 4096, 0),
    ),
    "m: millimetres?": (DEPTHS, np.full(PHASE.shape, 1500.0)),
    "above 347 m: millimetres? centimetres?": (DEPTHS, np.full(PHASE.shape, 347.0)),
    "above 150 m: centimetres? inches?": (DEPTHS, np.full(PHASE.shape, 150.0)),
    "above 1e+06 m: in which unit are they?": (DEPTHS, np.full(PHASE.shape, 1e6)),
    "mm: metres?": (DEPTHS | {"depth_unit": "mm"}, np.full(PHASE.shape, 1.5)),
}


@pytest.mark.parametrize("words", UNITS)
def test_images_in_another_unit_than_the_sidecar_says_are_refused(tmp_path, words):
    changes, values = UNITS[words]
    sidecar = sidecar_of(tmp_path, IMAGES | changes)
    with pytest.raises(CaptureError) as refused:
        sensor_pixels(raw_of(sidecar, p=values, a=np.abs(PHASOR)), sidecar)
    assert words in str(refused.value)


def test_negative_amplitudes_and_real_phasors_are_refused(tmp_path):
    sidecar = sidecar_of(tmp_path, IMAGES | PHASES)
    with pytest.raises(CaptureError, match="an amplitude is negative"):
        sensor_pixels(raw_of(sidecar, p=PHASE, a=-np.abs(PHASOR)), sidecar)
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors")
    with pytest.raises(CaptureError, match="phasors must be complex"):
        sensor_pixels(raw_of(sidecar, raw=PHASOR.real), sidecar)


KEYS = {
    "unknown key stepcount": {"stepcount": 4},
    "key horizontal_fov_deg is missing": {"horizontal_fov_deg": None},
    "frequencies_hz.0 must be 1e+06 to 1e+10 Hz (got 20): give Hz, as 20e6 for 20 MHz": {
        "frequencies_hz": [20.0, 50.0, 60.0]
    },
    "frequencies_hz.2 must be 1e+06 to 1e+10 Hz (got 60)": {"frequencies_hz": [20e6, 50e6, 60.0]},
    "frequencies_hz names a frequency twice": {"frequencies_hz": [20e6, 20e6]},
    "steps_rad.1 must be -12.5664 to 12.5664 radians (got 90): give radians, not degrees": {
        "step_count": None,
        "steps_rad": [0.0, 90.0, 180.0, 270.0],
    },
    "taps_rad.1 must be -12.5664 to 12.5664 radians (got 180): give radians, not degrees": {
        "tap_count": None,
        "taps_rad": [0.0, 180.0],
    },
    "do not tell amplitude, phase and background": {"step_count": 1},
    "2 steps and 1 taps do not tell": {"step_count": None, "tap_count": None, "steps_rad": [0.0, 1.0]},
    "give step_count or steps_rad, not both": {"steps_rad": [0.0, 1.0, 2.0]},
    "axes names place, which is none of frame, frequency": {"axes": ["row", "column", "place"]},
    "axes and stacked_along name an axis twice": {"axes": ["row", "column", "row"]},
    "axes must name row and column": {"axes": ["frame", "column"]},
    "several arrays need stacked_along": {"arrays": ["a", "b"]},
    "the layout amplitude-depth needs amplitude_arrays": {
        "layout": "amplitude-depth",
        "step_count": None,
        "tap_count": None,
    },
    "the layout phasors has neither steps nor taps": {"layout": "phasors"},
    "differences have no taps": {"layout": "differences"},
    "phase_unit dn and phase_period_dn go together": {"phase_unit": "dn"},
    "8-bit numbers are too coarse": {"bits": 8},
    "step_count must be less than or equal to 64": {"step_count": 65},
    "lens.fx must be 0.001 to 1e+06 pixels (got 1e-300)": {
        "lens": {"fx": 1e-300, "fy": 1.0, "cx": 0.0, "cy": 0.0}
    },
    "horizontal_fov_deg must be 1 to 170 degrees (got 200)": {"horizontal_fov_deg": 200.0},
    "phase_sign must be 1 or -1": {"phase_sign": 0},
    "format must be the name of a format": {"format": "../presets/paper"},
}


@pytest.mark.parametrize("words", KEYS)
def test_a_sidecar_with_a_wrong_key_is_refused(tmp_path, words):
    with pytest.raises(CaptureError) as refused:
        sidecar_of(tmp_path, **KEYS[words])
    assert str(refused.value).startswith(f"{tmp_path / 'sidecar.toml'}: ")
    assert words in str(refused.value)


def test_a_sidecar_changes_a_known_format_and_options_change_a_sidecar(tmp_path):
    changes = dict.fromkeys(TAPS) | {"format": "espros", "frequencies_hz": [24e6]}
    file = write_sidecar(tmp_path / "mine.toml", **changes)
    with pytest.raises(CaptureError, match=r"mine\.toml: key horizontal_fov_deg is missing"):
        load_sidecar(file)
    found, folder = load_sidecar(file, ["horizontal_fov_deg = 50", "phase_sign = -1"])
    assert (found.layout, found.frequencies_hz, found.phase_sign) == ("differences", (24e6,), -1)
    assert folder == tmp_path
    with pytest.raises(CaptureError, match="is no line of TOML"):
        load_sidecar(file, ["fov 50"])
    with pytest.raises(PresetError, match=r"one of adi-adtf3175, arducam, depthai, espros, flat, n"):
        load_sidecar("nothing")


@pytest.mark.parametrize("calibration_file", ["../dark.npz", "/etc/passwd", "link.npz"])
def test_a_sidecar_does_not_lead_out_of_its_folder(tmp_path, calibration_file):
    folder = tmp_path / "inner"
    folder.mkdir()
    np.savez(tmp_path / "dark.npz", dark=RAW)
    (folder / "link.npz").symlink_to(tmp_path / "dark.npz")
    sidecar = sidecar_of(folder, dark_arrays=["dark"], calibration_file=calibration_file)
    with pytest.raises(
        CaptureError, match=r"^calibration_file of the sidecar for frames\.npz: .*(inside|outside)"
    ):
        raw_of(sidecar, folder, raw=RAW)


COMPLEX = {
    "raw must hold real numbers": (TAPS | {"layout": "taps"}, {"raw": RAW + 1j}),
    "z must hold real numbers": (
        IMAGES | {"layout": "phasors", "arrays": ["z"], "imaginary_arrays": ["z"]},
        {"z": PHASOR[None]},
    ),
    "a must hold real numbers": (
        IMAGES | {"layout": "amplitude-phase", "arrays": ["p"], "amplitude_arrays": ["a"]},
        {"p": PHASE[None], "a": PHASOR[None]},
    ),
    "t must hold real numbers": (TAPS | {"exposure_array": "t"}, {"raw": RAW, "t": np.array([1 + 1j])}),
}


@pytest.mark.parametrize("words", COMPLEX)
def test_complex_numbers_are_refused_where_real_ones_are_meant(tmp_path, words):
    data, arrays = COMPLEX[words]
    with pytest.raises(CaptureError, match=words):
        raw_of(sidecar_of(tmp_path, data), **arrays)


def test_files_of_single_frequencies_must_be_as_many_as_the_frequencies(tmp_path):
    np.savez(tmp_path / "a.npz", raw=RAW[:, :, :, 0])
    sidecar = sidecar_of(
        tmp_path, without(TAPS, "axes"), files="frequencies", axes=["frame", "row", "column", "step", "tap"]
    )
    with pytest.raises(
        CaptureError, match="2 files were given, and the sidecar says that each holds one of 3"
    ):
        read_here([tmp_path / "a.npz"] * 2, sidecar)


# Files


def pickled(path):
    path.write_bytes(pickle.dumps({"raw": RAW}))


def external_group(path):
    with h5py.File(path, "w") as file:
        file["inner"] = h5py.ExternalLink("other.h5", "/")


OBJECT = MatlabObject(np.array([[(1.0,)]], dtype=[("a", object)]), "inline")


def matlab(values, end=None):
    def write(path):
        savemat(path, {"raw": values}, do_compression=end is not None)
        path.write_bytes(path.read_bytes()[:end])

    return write


FILES = {  # beside those of tests/trust/test_model_hostile_measurements.py: captures are read as these are
    ("inner is a link, which is not followed", "inner/raw.h5"): external_group,
    ("raw is a MATLAB variable of the kind struct, which is not read", "raw.mat"): matlab({"a": 1.0}),
    ("raw is a MATLAB variable of the kind cell", "raw.mat"): matlab(np.array([1, "a"], dtype=object)),
    ("raw is a MATLAB variable of the kind object", "raw.mat"): matlab(OBJECT),
    ("raw is a MATLAB variable of the kind char", "raw.mat"): matlab("text"),
    ("is damaged or no MATLAB file", "raw.mat"): matlab(RAW, end=-2000),
    ("is damaged or no MATLAB file", "inner.mat"): pickled,
}


@pytest.mark.parametrize(("words", "name"), FILES)
def test_files_that_are_damaged_or_made_to_do_harm_are_refused(tmp_path, words, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with h5py.File("other.h5", "w") as file:
        file["raw"] = RAW
    array, _, ending = name.rpartition(".")
    path = tmp_path / f"frames.{ending}"
    FILES[words, name](path)
    sidecar = sidecar_of(tmp_path, arrays=[array])
    with pytest.raises(RefusedError) as refused:
        read_here([path], sidecar)
    assert words in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [("no.npz", "no.npz does not exist"), ("raw.bin", "has the ending .bin: captures are read from .npz")],
)
def test_the_command_ends_with_one_sentence(tmp_path, name, words):
    (tmp_path / "raw.bin").touch()
    sidecar = write_sidecar(tmp_path / "sidecar.toml")
    said = refusal(
        "night-eval",
        "capture",
        "import",
        tmp_path / name,
        "--sidecar",
        sidecar,
        "--out",
        tmp_path / "out.npz",
    )
    assert words in said
    assert not (tmp_path / "out.npz").exists()
