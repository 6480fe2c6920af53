"""Captures and records that were made or edited to do harm, or given in a way that misleads."""

import json
import os
import shutil

import h5py
import numpy as np
import pytest
from captures import IMAGES, sidecar_of, steps, taps_of, write_sidecar
from night_commands import refusal
from scipy.io import savemat
from wall_measurements import wall_of_plane

from disk import sha256_of
from itof.capture.capture_files import refuse_repeated
from itof.capture.check_figure import check_figure
from itof.capture.checking import check_capture
from itof.capture.importing import import_capture
from itof.capture.raw_frames import read_frames
from itof.capture.record import read_import_record, record_path
from itof.capture.sidecar import CaptureError
from itof.files.array_claims import RefusedError
from itof.files.measurement_child import read_arrays

PHASOR = wall_of_plane().direct
RAW = taps_of(PHASOR, steps(4), steps(2))[None]


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Folder with a measurement file, its record, and what it was made of; for reading only."""
    folder = tmp_path_factory.mktemp("imported")
    np.savez(folder / "frames.npz", raw=np.concatenate([RAW, RAW]))
    sidecar = write_sidecar(folder / "sidecar.toml")
    import_capture(folder / "frames.npz", sidecar, folder / "corner.npz", progress=False)
    return folder


@pytest.fixture
def corner(imported, tmp_path):
    """A measurement file with its record, to be changed."""
    return shutil.copytree(imported, tmp_path, dirs_exist_ok=True) / "corner.npz"


# The same file twice


def test_a_file_that_is_given_twice_is_refused(tmp_path):
    one, other = tmp_path / "one.npz", tmp_path / "other.npz"
    np.savez(one, raw=RAW)
    np.savez(other, raw=2 * RAW)  # of the same size
    (tmp_path / "link.npz").symlink_to(one)
    (tmp_path / "copy.npz").write_bytes(one.read_bytes())
    refuse_repeated([one, other])
    with pytest.raises(
        CaptureError, match=r"link\.npz is given twice, also as .*one\.npz: give each file once"
    ):
        refuse_repeated([one, other, tmp_path / "link.npz"])
    with pytest.raises(CaptureError, match=r"copy\.npz and .*one\.npz have the same content"):
        refuse_repeated([one, tmp_path / "copy.npz"])
    sidecar = write_sidecar(tmp_path / "sidecar.toml")
    with pytest.raises(CaptureError, match=r"one\.npz is given twice"):
        import_capture([one, one], sidecar, tmp_path / "out.npz", progress=False)
    with pytest.raises(CaptureError, match=r"copy\.npz and .*one\.npz have the same content"):
        check_capture(one, sidecar, empty=tmp_path / "copy.npz", progress=False)
    assert not (tmp_path / "out.npz").exists()


# Records


@pytest.mark.parametrize(
    "change",
    [
        {"drift_rad": []},
        {"noise_rad": [1e300] * 3},
        {"noise_rad": [1e-3]},
        {"dead": 2.0},
        {"frames": 10**12},
        {"drift_rad": [-1.0] * 3},
    ],
)
def test_a_record_with_impossible_numbers_is_no_record(corner, change):
    record = json.loads(record_path(corner).read_text())
    assert read_import_record(corner) is not None
    record["facts"] |= change
    record_path(corner).write_text(json.dumps(record))
    assert read_import_record(corner) is None
    assert "has no record of an import beside it" in refusal("night-eval", "capture", "check", corner)


def test_a_record_of_other_frequencies_is_not_used(corner):
    record = json.loads(record_path(corner).read_text())
    record["sidecar"]["frequencies_hz"] = record["sidecar"]["frequencies_hz"][:2]
    for key in ("noise_rad", "drift_rad"):
        record["facts"][key] = record["facts"][key][:2]
    record_path(corner).write_text(json.dumps(record))
    assert read_import_record(corner) is not None
    with pytest.raises(CaptureError, match="has no record of an import beside it"):
        check_capture(corner)


def test_a_record_that_is_no_file_or_huge_is_not_read(corner):
    record_path(corner).unlink()
    os.mkfifo(record_path(corner))  # reading it would wait for ever
    assert read_import_record(corner) is None
    record_path(corner).unlink()
    with record_path(corner).open("wb") as stream:
        stream.truncate(2**40)  # without blocks on the disk
    assert read_import_record(corner) is None


def test_a_record_has_the_checksums_of_all_files(tmp_path):
    np.savez(tmp_path / "frames.npz", raw=RAW)
    np.savez(tmp_path / "corner.npz", raw=2 * RAW)
    np.savez(tmp_path / "dark.npz", dark=0 * RAW)
    sidecar = write_sidecar(tmp_path / "sidecar.toml", dark_arrays=["dark"], calibration_file="dark.npz")
    made = import_capture(
        tmp_path / "frames.npz", sidecar, tmp_path / "out.npz", empty=tmp_path / "corner.npz", progress=False
    )
    record = read_import_record(made.out)
    found = [(record.inputs, "frames"), (record.empty_inputs, "corner"), (record.calibration_inputs, "dark")]
    for files, name in found:
        file = (tmp_path / f"{name}.npz").resolve()
        assert files == {str(file): sha256_of(file)}
    path = record_path(made.out)
    names = {"calibration_inputs": "dark_inputs", "calibration_file": "dark_file"}  # of earlier versions
    for name, earlier in names.items():
        path.write_text(path.read_text().replace(name, earlier))
    assert read_import_record(made.out) == record


# Pictures


@pytest.mark.parametrize("shape", [(2, 3000, 3), (3000, 2, 3), (4, 6, 300)])
def test_pictures_of_thin_images_and_of_many_frequencies_have_a_usual_size(shape):
    width, height = check_figure("m.npz", np.ones(shape, complex), None, None, "fine").get_size_inches()
    assert 10 <= width <= 25
    assert 2 <= height <= 14


def test_only_an_earlier_picture_of_a_check_is_replaced(corner, tmp_path):
    from matplotlib.figure import Figure

    picture, foreign = tmp_path / "picture.png", tmp_path / "foreign.png"
    for _ in range(2):
        check_capture(corner, picture=picture)
    Figure().savefig(foreign)
    before = foreign.read_bytes()
    (tmp_path / "link.png").symlink_to("nowhere")
    for path in (foreign, tmp_path / "link.png", tmp_path):
        with pytest.raises(CaptureError, match="is there and is not the picture of a check"):
            check_capture(corner, picture=path)
    assert foreign.read_bytes() == before


# Memory


def with_npz(path, arrays):
    np.savez(path, **arrays)


def with_h5(path, arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values


@pytest.mark.parametrize(("ending", "write"), [("npz", with_npz), ("h5", with_h5), ("mat", savemat)])
def test_arrays_of_a_file_may_not_claim_too_much_together(tmp_path, monkeypatch, ending, write):
    path, names = tmp_path / f"m.{ending}", tuple("abc")
    write(path, {name: np.full((10, 1000), 0.5) for name in names})
    monkeypatch.setattr("disk.machine_memory.machine_bytes", lambda: 8 * 80_000)  # a quarter is two arrays
    assert set(read_arrays(path, ("a", "b"))[0]) == {"a", "b"}
    assert set(read_arrays(path, ("a", "b", "a"))[0]) == {"a", "b"}  # read once
    words = r"c of shape \(10, 1000\) with the arrays before it claims 234 KiB of memory"
    with pytest.raises(RefusedError, match=words):
        read_arrays(path, names)


def test_files_of_a_capture_may_not_claim_too_much_together(tmp_path, monkeypatch):
    files = [tmp_path / f"{place}.npz" for place in range(3)]
    for file in files:
        np.savez(file, raw=np.ones((1, 10, 1000)))
    sidecar = sidecar_of(
        tmp_path, IMAGES, layout="phasors", frequencies_hz=[20e6], axes=["frame", "row", "column"]
    )
    monkeypatch.setattr("disk.machine_memory.machine_bytes", lambda: 8 * 80_000)
    assert read_frames(files[:2], sidecar, tmp_path).values.shape == (2, 1, 1, 1, 10, 1000)
    with pytest.raises(CaptureError, match=r"2\.npz: raw of shape \(1, 10, 1000\) with the arrays before it"):
        read_frames(files, sidecar, tmp_path)
