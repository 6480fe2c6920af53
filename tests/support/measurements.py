"""Measurements of the closed-form scenes as files in every form that prediction reads, and its results."""

import h5py
import numpy as np

from itof import DepthMap
from itof.files.measurement_child import read_arrays
from itof.files.measurement_files import measurement_of
from itof.files.measurement_process import FileContents

FREQUENCIES_HZ = (20e6, 50e6, 60e6)


def write_npz(path, **changes):
    """An .npz measurement at the usual frequencies; a change of None leaves the array out."""
    arrays = {"frequencies_hz": np.array(FREQUENCIES_HZ)} | changes
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})
    return path


def write_h5(path, **arrays):
    with h5py.File(path, "w") as file:
        for name, values in ({"frequencies_hz": FREQUENCIES_HZ} | arrays).items():
            file[name] = values
    return path


def read_here(path):
    """The measurement in a file, read in this process and not in one of its own, which takes 0.3 s."""
    return measurement_of(path, FileContents(*read_arrays(path)))


def written(out, name="000000"):
    """Depth map of a prediction's EXR, at the first frequency."""
    found = DepthMap.read(out / f"{name}.exr")
    assert found.frequency_hz == FREQUENCIES_HZ[0]
    return found


def assert_same(out, other, name="000000"):
    ours, theirs = written(out, name), written(other, name)
    for part in ("radial_depth_m", "mask", "phasor"):
        np.testing.assert_array_equal(getattr(ours, part), getattr(theirs, part))
