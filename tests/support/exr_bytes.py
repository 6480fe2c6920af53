"""EXR files byte by byte: where the parts of the header are, and files of every kind and compression."""

import struct

import numpy as np
import OpenEXR

COMPRESSIONS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "ZSTD")  # that are read
OTHERS = ("DWAA", "DWAB", "HTJ2K256", "HTJ2K32")
SHAPE = (37, 24)  # more rows than a chunk of any of the compressions has, and a last chunk that is smaller


def pictures():
    """Channels of every number type, some of which compress well."""
    row, column = np.indices(SHAPE)
    smooth = np.sin(column / 5) + np.cos(row / 7)
    return {
        "a.Y": smooth.astype(np.float32),
        "b.Y": np.random.default_rng(0).random(SHAPE, dtype=np.float32),
        "c.Y": smooth.astype(np.float16),
        "d.Y": (1000 * smooth + 3000).astype(np.uint32),
    }


def write_exr(path, compression="ZIPS", **attributes):
    """An image that another program than NIGHT wrote."""
    method = getattr(OpenEXR, f"{compression}_COMPRESSION")
    header = {"compression": method, "type": OpenEXR.scanlineimage, **attributes}
    with OpenEXR.File(header, pictures()) as file:
        file.write(str(path))
    return path


def attribute(data, name):
    """Where the value of an attribute begins, and its length."""
    at = 8
    while data[at]:
        found, at = _text(data, at)
        _, at = _text(data, at)
        (length,) = struct.unpack_from("<i", data, at)
        at += 4
        if found == name:
            return at, length
        at += length
    raise KeyError(name)


def end_of_header(data):
    """Where the table of offsets begins."""
    at = 8
    while data[at]:
        _, at = _text(data, at)
        _, at = _text(data, at)
        at += 4 + struct.unpack_from("<i", data, at)[0]
    return at + 1


def _text(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(errors="replace"), end + 1
