"""EXR files of every kind, changed at random thousands of times: none crashes, hangs or takes all memory."""

import os
import random
import resource
import struct
import traceback

import numpy as np
import psutil
import pytest
from exr_bytes import COMPRESSIONS, OTHERS, end_of_header, write_exr

from itof import (
    ImageFileError,
    TransientLayout,
    TransientReader,
    TransientWriter,
    phasor_channels,
    read_image,
    write_image,
)

BATCH = 50  # files in one child
MEMORY_BYTES = 200 * 2**20  # that a child may take beside that of the tests, of which it is a copy


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Files by name; those of NIGHT first."""
    folder, rng = tmp_path_factory.mktemp("samples"), np.random.default_rng(1)
    phasor = rng.random((18, 24, 3)) + 1j * rng.random((18, 24, 3))
    parts = [phasor_channels(phasor, (20e6, 50e6, 60e6), part) for part in ("itof", "direct", "hidden")]
    attributes = {"recipe": '{"size": [24, 18]}', "generator": "test"}
    write_image(folder / "itof", {name: v for part in parts for name, v in part.items()}, attributes)
    cube = rng.random((18, 24, 200)) * (rng.random((18, 24, 200)) > 0.6)
    layout = TransientLayout(24, 18, 200, 0.05, 0.0)
    with TransientWriter(folder / "transient", layout, attributes) as writer:
        writer.write_rows(cube)
    for compression in (*COMPRESSIONS, *OTHERS):
        write_exr(folder / compression, compression)
    return folder


def changed(data, rng):
    """A copy with one to eight changes, most of them in the header or in the table of offsets."""
    data, header = bytearray(data), end_of_header(data)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        end = rng.choice((header, header, header + 8 * 18, len(data)))
        at = rng.randrange(min(end, len(data)) - 4)
        length = rng.randrange(1, 40)
        kind = rng.choice(("bit", "bit", "byte", "number", "splice", "cut", "insert", "delete", "zero"))
        if kind == "bit":
            data[at] ^= 1 << rng.randrange(8)
        elif kind == "byte":
            data[at] = rng.randrange(256)
        elif kind == "number":
            special = (0, 1, -1, 2**31 - 1, -(2**31), 2**30, rng.randrange(2**31))
            struct.pack_into("<i", data, at, rng.choice(special))
        elif kind == "splice":
            other = rng.randrange(end)
            data[at : at + length] = data[other : other + length]
        elif kind == "cut":
            del data[max(header, rng.randrange(len(data))) :]
        elif kind == "insert":
            data[at:at] = rng.randbytes(length)
        elif kind == "delete":
            del data[at : at + length]
        else:
            data[at : at + length] = bytes(len(data[at : at + length]))
        if len(data) < header:
            break
    return bytes(data)


def read_all(files, name):
    """Read files in a child.

    Returns
    -------
    Exit code of the child, or minus the signal that ended it; what it printed: a line for every file that it
    began, and one for every refusal; the largest memory that it took beside ours, bytes.
    """
    ours = psutil.Process().memory_info().rss
    log = files[0].with_name("log")
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))  # a hang
        os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        code = 70
        try:
            for file in files:
                os.write(2, f"{file.name}\n".encode())
                read(file, name)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), log.read_text(), 1024 * used.ru_maxrss - ours


def read(file, name):
    try:
        if name == "transient":
            with TransientReader(file) as reader:
                for block in reader.row_blocks():
                    block.sum()
        else:
            read_image(file)
    except ImageFileError as error:
        sentence = str(error)
        assert str(file) in sentence
        assert sentence.isprintable()
        assert len(sentence) < 600
        os.write(2, b"refused\n")


@pytest.mark.parametrize(
    ("changes", "seed"),
    [
        pytest.param(100, 1, marks=pytest.mark.long),
        pytest.param(1500, random.SystemRandom().randrange(2**32), id="1500", marks=pytest.mark.thorough),
    ],
)
@pytest.mark.parametrize("name", ["itof", "transient", *COMPRESSIONS, *OTHERS])
def test_no_change_of_an_exr_file_does_more_than_being_refused(samples, tmp_path, name, changes, seed):
    rng, data = random.Random(seed), (samples / name).read_bytes()  # noqa: S311
    refused = 0
    for start in range(0, changes, BATCH):
        files = [tmp_path / f"{number}.exr" for number in range(start, start + BATCH)]
        for file in files:
            file.write_bytes(changed(data, rng))
        code, log, used = read_all(files, name)
        assert code == 0, f"seed {seed}, files in {tmp_path}, exit code {code}: {log[-2000:]}"
        assert used < MEMORY_BYTES, f"seed {seed}, files in {tmp_path}: {used} bytes"
        refused += log.count("refused")
        for file in files:
            file.unlink()
    assert refused > changes // 3, f"seed {seed}: only {refused}"  # most changes are of what the header says
