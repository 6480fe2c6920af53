"""The check of an EXR file: what could crash OpenEXR, or make it use all memory, is refused before it."""

import os
import resource
import struct
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from exr_bytes import COMPRESSIONS, OTHERS, SHAPE, attribute, end_of_header, pictures, write_exr

from disk.machine_memory import limit_files
from itof import (
    ImageFileError,
    TransientLayout,
    TransientReader,
    TransientWriter,
    pixel_types,
    read_image,
    write_image,
)
from itof.exr.header import read_structure


def put(name, at, value):
    """A change of the value of an attribute."""

    def change(data):
        start, _ = attribute(data, name)
        data[start + at : start + at + len(value)] = value

    return change


def replaced(old, new):
    def change(data):
        assert data.count(old) >= 1
        data[:] = data.replace(old, new, 1)

    return change


def offset(index, change):
    """A change of an entry of the table of offsets."""

    def apply(data):
        at = end_of_header(data) + 8 * index
        (value,) = struct.unpack_from("<Q", data, at)
        struct.pack_into("<Q", data, at, change(value) % 2**64)

    return apply


def chunk(index, at, value):
    """A change of the head of a chunk: its row at 0, its length at 4."""

    def apply(data):
        (place,) = struct.unpack_from("<Q", data, end_of_header(data) + 8 * index)
        struct.pack_into("<i", data, place + at, value)

    return apply


def version(flags):
    return lambda data: struct.pack_into("<I", data, 4, flags)


def grown(name, length):
    return lambda data: struct.pack_into("<i", data, attribute(data, name)[0] - 4, length)


def box(*corners):
    return put("dataWindow", 0, struct.pack("<4i", *corners))


def doubled(data):
    """The last attribute of the header, twice."""
    end = end_of_header(data) - 1
    data[end:end] = b"night.note\0string\0\x02\0\0\0ok"


WIDTH, HEIGHT = SHAPE[1], SHAPE[0]
# Damage, and words of the refusal.
KILLERS = {
    "empty": (lambda data: data.clear(), "does not begin"),
    "magic": (lambda data: data.__setitem__(0, 0), "does not begin"),
    "version 3": (version(3), "only version 2"),
    "tiled": (version(2 | 0x200), "tiled"),
    "deep": (version(2 | 0x800), "deep"),
    "multi-part": (version(2 | 0x1000), "multi-part"),
    "unknown flag": (version(2 | 0x80000), "only version 2"),
    "type of another image": (replaced(b"scanlineimage", b"deepscanlinex"), "not a scan-line image"),
    "name without end": (replaced(b"night.note\0", b"night.note" + b"x" * 30), "a name has no end"),
    "channel that is no UTF-8": (replaced(b"a.Y", b"a\xffY"), "not UTF-8"),
    "channel with a control code": (replaced(b"a.Y", b"a\x1bY"), "cannot be printed"),
    "attribute that is no UTF-8": (replaced(b"night.note", b"night.\xff\xfe\xfd\xfc"), "not UTF-8"),
    "value that is no UTF-8": (put("night.note", 0, b"\xff\xff"), "not UTF-8"),
    "attribute twice": (doubled, "twice"),
    "attribute of 2 GiB": (grown("night.note", 2**31 - 1), "more than the file has left"),
    "attribute of negative length": (grown("night.note", -5), "more than the file has left"),
    "window of 15 bytes": (grown("dataWindow", 15), "has 15 bytes"),
    "no channels": (replaced(b"channels\0chlist", b"channelz\0chlist"), "no attribute channels"),
    "no window": (replaced(b"dataWindow\0box2i", b"dataWindow\0box2f"), "no attribute dataWindow"),
    "channel twice": (replaced(b"b.Y", b"a.Y"), "there twice"),
    "channel without a name": (put("channels", 0, b"\0" * 4), "list of channels"),
    "channel of an unknown type": (put("channels", 4, b"\x03"), "unknown number type"),
    "channel of every other pixel": (put("channels", 12, b"\x02"), "every pixel"),
    "channels without end": (replaced(b"\x01\0\0\0\x01\0\0\0b.Y", b"\x01\0\0\0\x01\0\0\0b.YYYY"), "its "),
    "unknown compression": (put("compression", 0, b"\x3f"), "its compression is none of"),
    "unknown order": (put("lineOrder", 0, b"\x02"), "order of its scan lines"),
    "no aspect ratio": (put("pixelAspectRatio", 0, struct.pack("<f", np.nan)), "not plausible"),
    "centre at infinity": (put("screenWindowCenter", 0, struct.pack("<f", np.inf)), "not finite"),
    "display window inside out": (put("displayWindow", 0, struct.pack("<i", 2**30)), "not plausible"),
    "window inside out": (box(0, 0, -2, HEIGHT - 1), "not plausible"),
    "window of 21.8 TiB": (box(0, 0, 2**22, 2**20), "more than a file of"),
    "window at the end of numbers": (box(-(2**31), 0, 2**31 - 1, 3), "not plausible"),
    "window with a row too few": (box(0, 0, WIDTH - 1, HEIGHT - 2), "scan lines"),
    "window with a row too many": (box(0, 0, WIDTH - 1, HEIGHT), "scan lines"),
    "window elsewhere": (box(0, 5, WIDTH - 1, HEIGHT + 4), "scan lines are not where"),
    "narrower window": (box(0, 0, 2, HEIGHT - 1), "scan lines do not have the size"),
    "offset beyond the file": (offset(3, lambda value: value + 10**9), "outside the file"),
    "negative offset": (offset(3, lambda value: -8), "outside the file"),
    "offset into the header": (offset(3, lambda value: 8), "outside the file"),
    "offset of no row": (offset(3, lambda value: 0), "outside the file"),
    "offset a byte off": (offset(3, lambda value: value + 1), "scan lines"),
    "offset of another row": (offset(3, lambda value: value - 1), "scan lines"),
    "row of a chunk": (chunk(3, 0, 4), "not where its header says"),
    "length of a chunk": (chunk(3, 4, 2**31 - 1), "size that its header says"),
    "negative length of a chunk": (chunk(3, 4, -1), "size that its header says"),
    "truncated": (lambda data: data.__delitem__(slice(-1, None)), "without gaps"),
    "followed by more": (lambda data: data.extend(b"more"), "without gaps"),
    "wrong number of chunks": (
        replaced(b"night.note\0string\0\x02\0\0\0ok", b"chunkCount\0int\0\x04\0\0\0\xff\0\0\0"),
        "chunkCount",
    ),
}


@pytest.fixture(scope="module")
def exr(tmp_path_factory):
    # the attribute has two letters
    return write_exr(tmp_path_factory.mktemp("exr") / "good.exr", **{"night.note": "ok"})


@pytest.mark.parametrize("damage", KILLERS)
def test_a_damaged_header_is_refused_before_openexr_sees_it(exr, tmp_path, damage):
    change, words = KILLERS[damage]
    data = bytearray(exr.read_bytes())
    change(data)
    file = tmp_path / "damaged.exr"
    file.write_bytes(data)
    with file.open("rb") as stream, pytest.raises(ImageFileError, match=words):
        read_structure(stream)  # which does not know OpenEXR
    for read in (read_image, pixel_types, TransientReader):
        with pytest.raises(ImageFileError) as refused:
            read(file)
        assert str(file) in str(refused.value)
        assert words in str(refused.value)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_files_of_other_programs_are_read_in_every_supported_compression(tmp_path, compression):
    file = write_exr(tmp_path / "a.exr", compression)
    with OpenEXR.File(str(file), separate_channels=True) as other:
        expected = {name: channel.pixels for name, channel in other.channels().items()}
    found = read_image(file)
    assert found.channels.keys() == pictures().keys()
    for name, values in found.channels.items():
        np.testing.assert_array_equal(values, expected[name].astype(np.float32))
    assert pixel_types(file) == {"a.Y": "FLOAT", "b.Y": "FLOAT", "c.Y": "HALF", "d.Y": "UINT"}


@pytest.mark.parametrize("compression", OTHERS)
def test_other_compressions_are_refused_by_name(tmp_path, compression):
    file = write_exr(tmp_path / "a.exr", compression)
    with pytest.raises(ImageFileError, match=r"a\.exr cannot be used: its compression is none of NONE, RLE"):
        read_image(file)


def test_a_tiled_image_is_refused(tmp_path):
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 16
    with OpenEXR.File({"type": OpenEXR.tiledimage, "tiles": tiles}, pictures()) as file:
        file.write(str(tmp_path / "a.exr"))
    with pytest.raises(ImageFileError, match="tiled image, and only single-part scan-line images are read"):
        read_image(tmp_path / "a.exr")


def test_a_file_may_have_any_name_for_reading_and_one_in_utf_8_for_writing(tmp_path):
    values = np.ones((2, 3), np.float32)
    write_image(tmp_path / "ö.exr", {"Y": values}, {})
    odd = tmp_path / os.fsdecode(b"\xff.exr")  # on which OpenEXR crashes the process
    os.link(tmp_path / "ö.exr", odd)
    np.testing.assert_array_equal(read_image(odd).channel("Y"), values)
    with pytest.raises(OSError, match="a name that is UTF-8"):
        write_image(tmp_path / os.fsdecode(b"\xfe.exr"), {"Y": values}, {})


def test_advice_ends_the_sentence_about_a_damaged_file_and_is_no_advice_to_delete(exr, tmp_path):
    (tmp_path / "a.exr").write_bytes(exr.read_bytes()[:-1])
    for read in (read_image, TransientReader):
        with pytest.raises(ImageFileError, match=r"a\.exr is damaged or no EXR file .*truncated\): ask Ann$"):
            read(tmp_path / "a.exr", advice="ask Ann")
        with pytest.raises(ImageFileError) as refused:
            read(tmp_path / "a.exr")
        assert "delete" not in str(refused.value)


def test_what_does_not_fit_into_memory_is_refused_by_its_size(tmp_path, monkeypatch):
    write_image(tmp_path / "image.exr", {"Y": np.zeros((64, 64))}, {})
    with TransientWriter(tmp_path / "t.exr", TransientLayout(8, 4, 100, 0.01, 0.0), {}) as writer:
        writer.write_rows(np.zeros((4, 8, 100)))
    image_bytes, block_bytes = 64 * 64 * 4, 4 * 8 * 100 * 4
    row_bytes = (2 * 64 * 4, 2 * 8 * 100 * 4)  # OpenEXR unpacks a row, with twice its size
    monkeypatch.setattr("disk.machine_memory.machine_bytes", lambda: 8 * (image_bytes + row_bytes[0]) - 1)
    with pytest.raises(ImageFileError, match=r"claims 16\.5 KiB of memory, and this machine has 132 KiB"):
        read_image(tmp_path / "image.exr")
    monkeypatch.setattr("disk.machine_memory.machine_bytes", lambda: 6 * (block_bytes + row_bytes[1]))
    with TransientReader(tmp_path / "t.exr") as reader:  # a block of it fits
        assert reader.read_rows(0, 4).shape == (4, 8, 100)
        assert reader.phasors([20e6]).shape == (4, 8, 1)
        with pytest.raises(ImageFileError, match=r"t\.exr claims 20 KiB of memory"):
            reader.phasors([20e6 + hz for hz in range(40)])  # 16 bytes, 40 frequencies, 32 pixels, 3 times
    monkeypatch.setattr("disk.machine_memory.machine_bytes", lambda: 5000)
    with pytest.raises(ImageFileError, match=r"claims 18\.8 KiB of memory"):
        TransientReader(tmp_path / "t.exr")


@pytest.mark.parametrize(("compression", "together"), [("ZIPS", 1), ("ZIP", 16), ("PIZ", 32)])
def test_rows_that_are_packed_together_are_unpacked_together(tmp_path, compression, together):
    with write_exr(tmp_path / "a.exr", compression).open("rb") as stream:
        found = read_structure(stream)
    assert found.chunk_lines == together
    assert found.unpacking_bytes == 2 * found.row_bytes * min(together, found.height)


def test_limits_of_a_job_are_those_of_its_group_and_of_all_above_it():
    second = limit_files("0::/slurm/job_7/step_0\n")
    assert Path("/sys/fs/cgroup/slurm/job_7/step_0/memory.max") in second
    assert Path("/sys/fs/cgroup/slurm/memory.max") in second
    assert Path("/sys/fs/cgroup/memory.max") in second
    first = limit_files("5:devices:/other\n4:cpu,memory:/slurm/job_7\n0::/\n")
    assert Path("/sys/fs/cgroup/memory/slurm/job_7/memory.limit_in_bytes") in first
    assert not any("other" in str(file) for file in first)
    assert not any(".." in str(file) for file in limit_files("0::/../../etc\n"))
    assert limit_files("")


def test_a_name_that_the_system_refuses_is_an_error_of_the_image(tmp_path):
    with pytest.raises(ImageFileError, match="cannot be read: File name too long"):
        read_image(tmp_path / ("n" * 300))


def test_reading_in_several_threads_gives_stderr_back(tmp_path):
    write_image(tmp_path / "image.exr", {"Y": np.zeros((8, 8))}, {})
    before = os.fstat(2)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: read_image(tmp_path / "image.exr"), range(200)))
    assert os.path.samestat(os.fstat(2), before)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("bin_width_m", "inf", "impossible time axis"),
        ("bin_width_m", "1e-300", r"bin_width_m must be 1e-09 to 1e\+06 m"),
        ("start_opl_m", "nan", "impossible time axis"),
        ("bin_count", "-7", "impossible time axis"),
        ("bin_count", "99999", "impossible time axis"),
    ],
)
def test_a_time_axis_that_cannot_be_is_refused(tmp_path, name, text, words):
    layout = TransientLayout(2, 3, 12345, 0.012345, 0.54321)
    with TransientWriter(tmp_path / "t.exr", layout, {}) as writer:
        writer.write_rows(np.ones((3, 2, 12345)))
    data = bytearray((tmp_path / "t.exr").read_bytes())
    start, length = attribute(data, f"night.{name}")
    data[start : start + length] = text.encode().ljust(length)
    (tmp_path / "t.exr").write_bytes(data)
    with pytest.raises(ImageFileError, match=words):
        TransientReader(tmp_path / "t.exr")


def test_more_bins_than_presets_allow_are_refused(tmp_path):
    with TransientWriter(tmp_path / "t.exr", TransientLayout(1, 1, 10_000_001, 0.01, 0.0), {}) as writer:
        writer.write_rows(np.zeros((1, 1, 10_000_001)))
    with pytest.raises(ImageFileError, match="10000001 time bins, and at most 10000000 are read"):
        TransientReader(tmp_path / "t.exr")


@contextmanager
def no_file_above(count):
    """What the system does on a full disk, at this many bytes of a file."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (count, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_an_image_that_was_not_written_to_its_end_is_an_error_that_names_it(tmp_path):
    values = np.random.default_rng(0).random((30, 30))
    write_image(tmp_path / "whole.exr", {"Y": values}, {})
    size = (tmp_path / "whole.exr").stat().st_size
    for number, count in enumerate((0, 100, size // 2, size - 1)):
        file = tmp_path / f"{number}.exr"
        with no_file_above(count), pytest.raises(OSError) as failed:
            write_image(file, {"Y": values}, {})
        assert failed.value.filename == str(file)
    with no_file_above(size):
        write_image(tmp_path / "again.exr", {"Y": values}, {})


def test_a_transient_that_was_not_written_to_its_end_is_an_error_that_names_it(tmp_path):
    layout, values = TransientLayout(20, 30, 10, 0.01, 0.0), np.random.default_rng(0).random((30, 20, 10))

    def write(file):
        with TransientWriter(file, layout, {}) as writer:
            writer.write_rows(values)

    write(tmp_path / "whole.exr")
    size = (tmp_path / "whole.exr").stat().st_size
    for number, count in enumerate((0, size // 2, size - 1)):
        file = tmp_path / f"{number}.exr"
        with no_file_above(count), pytest.raises(OSError) as failed:
            write(file)
        assert failed.value.filename == str(file)
