"""Measurement files that cannot be used: each is refused in one sentence."""

import pickle
import shutil
import zipfile

import h5py
import numpy as np
import pytest
from measurements import read_here, write_h5, write_npz
from night_commands import refusal

from itof import phasor_channels, write_image
from itof.exr.image import PROJECTOR
from itof.files.array_claims import RefusedError
from itof.files.measurement_files import MeasurementError

pytestmark = pytest.mark.usefixtures("one_thread")


def bare_array(path, phasors):
    np.save(path.with_suffix(".npy"), phasors)
    path.with_suffix(".npy").rename(path)


def pickled_array(path, phasors):
    write_npz(path, phasors=np.array([phasors, None], dtype=object))


def pickle_file(path, phasors):
    path.write_bytes(pickle.dumps({"phasors": phasors}))


def truncated(path, phasors):
    write_npz(path, phasors=phasors)
    path.write_bytes(path.read_bytes()[:-200])


def with_nan(phasors):
    spoilt = phasors.copy()
    spoilt[1, 2, 3, 0] = np.nan
    return spoilt


def damaged_header(path, phasors):
    """An archive with an array whose header lacks its closing brace."""
    write_npz(path, phasors=phasors)
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    contents["phasors.npy"] = contents["phasors.npy"].replace(b"}", b"(", 1)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, content)


NPZ_REFUSALS = {
    "one bare array": bare_array,
    "pickled Python objects": pickled_array,
    "pickled Python objects, which could run": pickle_file,
    "damaged or no .npz archive": truncated,
    "damaged or no .npz archive (": damaged_header,
    "no array phasors; it holds frequencies_hz, phase": lambda p, z: write_npz(p, phase=z),
    "no array frequencies_hz; it holds phasors": lambda p, z: write_npz(p, phasors=z, frequencies_hz=None),
    "must be complex, Re + j Im, got float32": lambda p, z: write_npz(p, phasors=z.real),
    "must have the shape (H, W, F) or (N, H, W, F), got (14, 24)": lambda p, z: write_npz(
        p, phasors=z[0, ..., 0]
    ),
    "must have 3 values on its last axis": lambda p, z: write_npz(p, phasors=z[..., :2]),
    "image 1 of phasors holds 1 values that are NaN": lambda p, z: write_npz(p, phasors=with_nan(z)),
    "frequencies_hz must be a list of numbers": lambda p, z: write_npz(
        p, phasors=z, frequencies_hz=np.array(["20 MHz"])
    ),
    "frequencies_hz must be different positive numbers": lambda p, z: write_npz(
        p, phasors=z, frequencies_hz=np.array([20e6, 20e6, -1])
    ),
    "reference of shape (13, 24, 3) does not fit": lambda p, z: write_npz(p, phasors=z, reference=z[0, 1:]),
    "reference holds 1008 values that are NaN": lambda p, z: write_npz(p, phasors=z, reference=z[0] * np.nan),
    "reference is 0 in 336 pixels that have light": lambda p, z: write_npz(p, phasors=z, reference=0 * z[0]),
}


RUN_REFUSALS = {  # for which the run must be known
    "holds images of 23x14 pixels": lambda p, z: write_npz(p, phasors=z[:, :, 1:]),
    "holds images of 14x24 pixels": lambda p, z: write_npz(p, phasors=np.swapaxes(z, 1, 2)),
    "holds 20, 60 MHz, the network also needs 50 MHz": lambda p, z: write_npz(
        p, phasors=z[..., [0, 2]], frequencies_hz=np.array([20e6, 60e6])
    ),
    "frequencies_hz is in Hz, not MHz": lambda p, z: write_npz(
        p, phasors=z, frequencies_hz=np.array([20, 50, 60])
    ),
    "no wall found: no pixel holds light": lambda p, z: write_npz(p, phasors=0 * z),
    "which could run any program": pickled_array,
}


def refused(run, file, out):
    return refusal("night-eval", "predict", run, file, "--out", out, "--device", "cpu")


@pytest.mark.parametrize("words", NPZ_REFUSALS)
def test_an_unusable_npz_is_refused_in_one_sentence(phasors, tmp_path, words):
    NPZ_REFUSALS[words](tmp_path / "m.npz", phasors)
    with pytest.raises((RefusedError, MeasurementError)) as error:
        read_here(tmp_path / "m.npz")
    assert words in str(error.value)
    assert "m.npz" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("words", RUN_REFUSALS)
def test_an_npz_that_does_not_fit_the_run_is_refused_in_one_sentence(finished_run, phasors, tmp_path, words):
    RUN_REFUSALS[words](tmp_path / "m.npz", phasors)
    message = refused(finished_run, tmp_path / "m.npz", tmp_path / "out")
    assert words in message
    assert "m.npz" in message
    assert not (tmp_path / "out").exists()


def test_files_that_hold_no_measurement_are_refused_in_one_sentence(finished_run, exr, phasors, tmp_path):
    (tmp_path / "no.h5").write_text("no HDF5")
    (tmp_path / "group.h5").mkdir()
    whole = write_h5(tmp_path / "m.h5", phasors=phasors)
    (tmp_path / "half.h5").write_bytes(whole.read_bytes()[:3000])
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.create_group("phasors")
    (tmp_path / "half.exr").write_bytes(exr.read_bytes()[:-300])
    shutil.copy(exr.with_name("mirrored.exr"), tmp_path / "truth.exr")
    write_image(tmp_path / "photo.exr", {"R": np.ones((14, 24))}, {})
    lit_by_dots = phasor_channels(np.ones((14, 24, 1)), (20e6,))
    write_image(tmp_path / "dots.exr", lit_by_dots, {PROJECTOR: "own"})
    (tmp_path / "m.png").write_bytes(b"")
    for name, words in (
        ("nowhere.npz", "does not exist"),
        ("nowhere.exr", "does not exist"),
        ("group.h5", "is a folder"),
        ("half.h5", "damaged or no HDF5 file"),
        ("half.exr", "damaged or no EXR"),
        ("truth.exr", "holds 20 MHz, the network also needs 50, 60 MHz"),
        ("m.png", "measurements are read from .exr, .npz, .h5, .hdf5 files: night-eval capture import"),
    ):
        message = refused(finished_run, tmp_path / name, tmp_path / "out")
        assert words in message, message
        assert name in message
        assert "delete" not in message  # it is the user's own file
        assert not (tmp_path / "out").exists()
    for name, words in (
        ("no.h5", "no HDF5 file"),
        ("other.h5", "no array phasors; it holds phasors: .*capture import .*other.h5 --sidecar"),
        ("photo.exr", "holds no phasors"),
        ("dots.exr", "has the light of a projector of its own"),
    ):
        with pytest.raises((RefusedError, MeasurementError), match=f"{name}.*{words}"):
            read_here(tmp_path / name)
