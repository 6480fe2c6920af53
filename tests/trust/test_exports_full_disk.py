"""Full disks: what is made of renders is whole or not there, and one sentence names the file."""

import pytest
from full_disk import file_size_limit

from render.products.conversion import ExportError, convert_to_itof, open_transient
from render.products.deferred_error_file import DeferredErrorFile
from render.products.movie import MovieOptions, write_movie
from render.products.tal_export import export_tal


def film(dataset, file):
    with open_transient(dataset, "000000") as transient:
        write_movie(transient, file, MovieOptions(max_frames=3, min_width=240))


WRITERS = {
    "000000_itof.exr": lambda data, file: convert_to_itof(data, "000000", file.parent),
    "capture.hdf5": lambda data, file: export_tal(data, "000000", file),
    "film.gif": film,
    "film.mp4": film,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_found_no_room_is_named_and_leaves_nothing(transient_dataset, tmp_path, name):
    (tmp_path / "whole").mkdir()
    WRITERS[name](transient_dataset, tmp_path / "whole" / name)
    size = (tmp_path / "whole" / name).stat().st_size
    limits = (0, size // 2, size - 1) if name == "film.mp4" else (0, 1, 600, 3000, size // 2, size - 1)
    for limit in limits:
        folder = tmp_path / str(limit)
        with file_size_limit(limit), pytest.raises(ExportError) as refused:
            WRITERS[name](transient_dataset, folder / name)
        assert str(refused.value) == f"cannot write {folder / name}: File too large"
        assert list(folder.iterdir()) == []


def test_hdf5_reads_back_what_found_no_room(tmp_path):
    with DeferredErrorFile(tmp_path / "a") as file:
        assert file.write(b"0123456789") == 10
        file.raise_error()
        with file_size_limit(12):
            file.seek(8)
            assert file.write(b"abcdefgh") == 8  # of which four bytes find room
            assert file.write(b"ijkl") == 4
        file.seek(10)
        file.write(b"C")  # after an error, nothing is written to the disk
        assert (file.seek(0), file.read()) == (0, b"01234567abCdefghijkl")
        file.seek(7)
        assert file.read(4) == b"7abC"
        file.truncate(25)
        assert file.seek(0, 2) == 25
        file.seek(18)
        assert file.read() == b"kl" + bytes(5)
        with pytest.raises(OSError, match="File too large"):
            file.raise_error()
    assert (tmp_path / "a").read_bytes()[:12] == b"01234567abcd"
