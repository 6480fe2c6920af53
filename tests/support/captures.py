"""Raw frames of closed-form phasors, and the sidecars that say what they mean."""

import numpy as np
from wall_measurements import FREQUENCIES_HZ

from itof.capture.capture_files import layout_of
from itof.capture.raw_frames import frames_of
from itof.capture.sidecar_files import load_sidecar
from itof.files.measurement_child import read_arrays
from itof.files.measurement_process import FileContents

TAPS = {
    "layout": "taps",
    "arrays": ["raw"],
    "axes": ["frame", "row", "column", "frequency", "step", "tap"],
    "frequencies_hz": list(FREQUENCIES_HZ),
    "horizontal_fov_deg": 60.0,
    "step_count": 4,
    "tap_count": 2,
}
IMAGES = {key: value for key, value in TAPS.items() if "count" not in key} | {
    "axes": ["frame", "row", "column", "frequency"]
}


def without(data, *keys):
    return {key: value for key, value in data.items() if key not in keys}


def toml(value):
    """A value as text of TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(each) for each in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def write_sidecar(path, data=TAPS, **changes):
    """A sidecar file; a change of None leaves the key out."""
    keys = {key: value for key, value in (data | changes).items() if value is not None}
    path.write_text("".join(f"{key} = {toml(value)}\n" for key, value in keys.items()))
    return path


def sidecar_of(folder, data=TAPS, **changes):
    """The sidecar that a file in the folder describes."""
    return load_sidecar(write_sidecar(folder / "sidecar.toml", data, **changes))[0]


def taps_of(phasor, steps_rad, taps_rad, background=2.0):
    """(H, W, F, S, T) numbers of the taps: T taps share the light of phasors (H, W, F)."""
    angle = np.asarray(steps_rad)[:, None] + np.asarray(taps_rad)  # (S, T)
    wave = (phasor[..., None, None] * np.exp(-1j * angle)).real
    return (background * np.abs(phasor)[..., None, None] + wave) / len(taps_rad)


def steps(count):
    return 2 * np.pi * np.arange(count) / count


def raw_of(sidecar, folder=None, **arrays):
    """Frames in arrays, as if they were in one file."""
    return frames_of([("frames.npz", FileContents(arrays, list(arrays)))], sidecar, folder)


def read_here(files, sidecar, folder=None):
    """Frames in files, read in this process and not in one of its own, which takes 0.3 s."""
    read = [(file, read_arrays(file, sidecar.wanted, layout_of(file, sidecar))) for file in files]
    return frames_of([(file, FileContents(*contents)) for file, contents in read], sidecar, folder)
