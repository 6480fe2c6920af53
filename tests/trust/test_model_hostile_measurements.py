"""Measurement files made to do harm, and the process that reads such files."""

import contextlib
import io
import os
import signal
import subprocess
import sys
import threading
import time
import zipfile

import h5py
import numpy as np
import psutil
import pytest
from measurements import FREQUENCIES_HZ, read_here, write_h5, write_npz
from night_commands import refusal

from itof.files.array_claims import RefusedError
from itof.files.measurement_files import MeasurementError, read_measurement

SHAPE = (4, 6, 3)  # (H, W, F)
PHASORS = (np.arange(72) * (1 + 2j)).reshape(SHAPE).astype(np.complex64)
VALUES = PHASORS.tobytes()
HUGE = (10**6, 1000, 1000, 3)  # 21.8 TiB


# NPZ


def write_raw_npz(path, header, data=VALUES):
    """An archive whose array ``phasors`` has this header, a dictionary or bytes, and these bytes."""
    stream = io.BytesIO()
    if isinstance(header, dict):
        complete = {"descr": "<c8", "fortran_order": False, "shape": SHAPE} | header
        np.lib.format.write_array_header_1_0(stream, complete)
    else:
        stream.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("phasors.npy", stream.getvalue() + data)
        stream = io.BytesIO()
        np.save(stream, np.array(FREQUENCIES_HZ))
        archive.writestr("frequencies_hz.npy", stream.getvalue())


NPZ = {
    "shape (1000000, 1000, 1000, 3) claims 21.8 TiB, but the file holds only": {"shape": HUGE},
    "claims more than 1000 PiB, but the file holds only": {"shape": (2**62, 2**62, 3)},
    "has the shape (-4, 6, 3)": {"shape": (-4, 6, 3)},
    "ends too early": {"shape": (8, 6, 3)},
    "is followed by other data": {"shape": (2, 6, 3)},
    "must be complex, Re + j Im, got |V8": {"descr": "|V8"},
    "which could run any program": {"descr": "|O"},
    "must be complex, Re + j Im, got [": {"shape": (4, 6), "descr": [("r", "<f4", (3,)), ("i", "<f4", (3,))]},
    "nested too deeply": b"-" * 9000 + b"\n",
    "EOF in multi-line": b"(" * 9000 + b"\n",
}


@pytest.mark.parametrize("words", NPZ)
def test_an_npz_that_claims_what_it_does_not_hold_is_refused(tmp_path, words):
    write_raw_npz(tmp_path / "m.npz", NPZ[words])
    with pytest.raises(RefusedError) as refused:
        read_here(tmp_path / "m.npz")
    assert words in str(refused.value)


def test_an_archive_that_expands_to_more_than_the_memory_is_refused(tmp_path, monkeypatch):
    zeros = bytes(8 * 400 * 600 * 3)
    write_raw_npz(tmp_path / "bomb.npz", {"shape": (400, 600, 3)}, zeros)
    assert (tmp_path / "bomb.npz").stat().st_size < len(zeros) / 500
    assert read_here(tmp_path / "bomb.npz").phasors.shape == (1, 400, 600, 3)
    monkeypatch.setattr("disk.machine_memory.machine_bytes", lambda: 3 * len(zeros))
    words = r"claims 5\.49 MiB of memory, and this machine has 16\.5 MiB \(at most 25% of it may be claimed\)"
    with pytest.raises(RefusedError, match=words):  # two processes have a copy each
        read_here(tmp_path / "bomb.npz")


def test_other_compressions_orders_and_byte_orders_are_read(tmp_path):
    for number, compression in enumerate((zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)):
        with zipfile.ZipFile(tmp_path / f"{number}.npz", "w", compression) as archive:
            for name, values in (
                ("phasors", np.asfortranarray(PHASORS.astype(">c16"))),
                ("frequencies_hz", np.array(FREQUENCIES_HZ, ">f8")),
            ):
                stream = io.BytesIO()
                np.save(stream, values)
                archive.writestr(f"{name}.npy", stream.getvalue())
        found = read_here(tmp_path / f"{number}.npz")
        assert found.frequencies_hz == FREQUENCIES_HZ
        np.testing.assert_array_equal(found.phasors, PHASORS[None])


# HDF5


def create(file, shape=SHAPE, **options):
    """A data set ``phasors`` without values, by HDF5's own options."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    for name, values in options.items():
        getattr(plan, name)(*values)
    kind, space = h5py.h5t.py_create(np.dtype("c8"), logical=True), h5py.h5s.create_simple(shape)
    h5py.h5d.create(file.id, b"phasors", kind, space, plan)


def mosaic(file):
    layout = h5py.VirtualLayout(SHAPE, "c8")
    layout[:] = h5py.VirtualSource("other.h5", "phasors", SHAPE)
    file.create_virtual_dataset("phasors", layout)


def references(file):
    file["there"] = PHASORS
    file.create_dataset("phasors", (2,), h5py.ref_dtype)


HDF5 = {
    "phasors is a link, which is not followed": lambda f: f.update_link(
        h5py.ExternalLink("other.h5", "/phasors")
    ),
    "phasors is a link, which is": lambda f: f.update_link(h5py.SoftLink("/frequencies_hz")),
    "phasors has its values in another file": lambda f: create(f, set_external=(b"/etc/passwd", 0, 576)),
    "phasors is a virtual data set": mosaic,
    "through the HDF5 filters [32015]": lambda f: create(f, set_chunk=(SHAPE,), set_filter=(32015, 1, ())),
    "claims 21.8 TiB, but the file holds only 0 bytes": lambda f: create(f, HUGE),
    "claims 21.8 TiB, but": lambda f: create(f, HUGE, set_chunk=((1, 10, 10, 3),), set_deflate=(9,)),
    "phasors must be numbers, got references": references,
    "phasors must be numbers, got": lambda f: f.create_dataset("phasors", (2,), h5py.vlen_dtype("f4")),
    "phasors must be complex, Re + j Im": lambda f: f.create_dataset("phasors", SHAPE, "f4,i4"),
    "phasors is a data set without values": lambda f: f.create_dataset("phasors", data=h5py.Empty("c8")),
    "phasors must have the shape": lambda f: f.create_dataset("phasors", data=np.complex64(1)),
}


class Linking(h5py.File):
    def update_link(self, link):
        self["phasors"] = link


@pytest.mark.parametrize("words", HDF5)
def test_an_hdf5_file_whose_values_lie_elsewhere_or_nowhere_is_refused(tmp_path, words, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_h5("other.h5", phasors=PHASORS)
    with Linking("m.h5", "w") as file:
        file["frequencies_hz"] = FREQUENCIES_HZ
        HDF5[words](file)
    with pytest.raises((RefusedError, MeasurementError)) as refused:
        read_here(tmp_path / "m.h5")
    assert words in str(refused.value)


def test_the_usual_ways_of_storing_are_read(tmp_path):
    for number, options in enumerate(
        (
            {"compression": "gzip", "shuffle": True, "fletcher32": True},
            {"compression": "lzf"},
            {"chunks": (1, 6, 3)},
        )
    ):
        with h5py.File(tmp_path / f"{number}.h5", "w") as file:
            file.create_dataset("phasors", data=PHASORS.astype(">c16"), **options)
            file["frequencies_hz"] = np.array(FREQUENCIES_HZ, int)
            file["ref"] = file["phasors"]  # another name of the same data
        found = read_here(tmp_path / f"{number}.h5")
        assert found.frequencies_hz == FREQUENCIES_HZ
        assert found.ignored == ("ref",)
        np.testing.assert_array_equal(found.phasors, PHASORS[None])


# The process that reads


def test_the_process_sends_what_the_file_holds_and_names_what_it_ignores(tmp_path, monkeypatch):
    (tmp_path / "numpy.py").write_text("raise SystemExit('a module of the current folder was imported')")
    (tmp_path / "model.py").write_text("raise SystemExit('a module of the current folder was imported')")
    monkeypatch.chdir(tmp_path)
    reference = PHASORS + 1j
    write_npz("m.npz", phasors=PHASORS, reference=reference, **{"ref\n\x1b[31m": PHASORS})
    found = read_measurement("m.npz")
    np.testing.assert_array_equal(found.phasors, PHASORS[None])
    np.testing.assert_array_equal(found.reference, reference)
    assert found.ignored == ("ref ?[31m",)
    assert found.at([50e6]).ignored == found.ignored


def test_an_exr_names_channels_that_are_not_nights(tmp_path):
    from itof import phasor_channels, write_image

    parts = {
        n: v for part in ("itof", "direct") for n, v in phasor_channels(PHASORS, FREQUENCIES_HZ, part).items()
    }
    write_image(tmp_path / "m.exr", parts | {"R": PHASORS[..., 0].real}, {})
    found = read_here(tmp_path / "m.exr")
    assert found.ignored == ("R",)
    np.testing.assert_array_equal(found.phasors, PHASORS[None])


def test_a_crash_of_the_process_is_one_sentence_that_names_the_file(tmp_path):
    file = write_npz(tmp_path / "m.npz", phasors=PHASORS)
    for number, words in (
        (signal.SIGSEGV, "the library that reads such files crashed on it (SIGSEGV)"),
        (signal.SIGKILL, "was killed, perhaps because memory ran out"),
        (signal.SIGXCPU, "cannot be read in reasonable time"),
    ):
        killer = threading.Thread(target=kill_reader, args=(number,))
        killer.start()
        with pytest.raises(MeasurementError) as refused:
            read_measurement(file)
        killer.join()
        assert str(file) in str(refused.value)
        assert words in str(refused.value)


def kill_reader(number):
    """Send a signal to the process that reads a measurement, as soon as there is one."""
    this, deadline = psutil.Process(), time.monotonic() + 600
    while time.monotonic() < deadline:
        for child in this.children():
            with contextlib.suppress(psutil.Error):  # it has just ended
                if any("measurement_child" in word for word in child.cmdline()):
                    os.kill(child.pid, number)
                    return


def test_a_file_that_claims_too_much_is_refused_by_the_command(finished_run, tmp_path):
    write_raw_npz(tmp_path / "m.npz", {"shape": HUGE})
    message = refusal("night-eval", "predict", finished_run, tmp_path / "m.npz", "--out", tmp_path / "out")
    assert f"{tmp_path / 'm.npz'}: phasors of shape {HUGE} claims 21.8 TiB" in message
    assert "write it again" in message
    assert "resolution" not in message
    assert not (tmp_path / "out").exists()


def test_reading_a_measurement_needs_no_hdf5_library_in_the_process_that_uses_it():
    code = (
        "import sys; from itof.files import measurement_files; "
        "sys.exit(bool({'h5py', 'torch'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
