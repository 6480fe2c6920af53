"""The process that reads a user's measurement file (`itof.files.measurement_process` starts it).

It writes to its standard output: one line of JSON, then the bytes of the arrays, one after the other. The
line is ``{"refusal": sentence}``, or ``{"arrays": [[name, number type, shape], ...], "names": [...]}`` with
the names of all that the file has. It needs neither torch nor pydantic and starts in a fraction of a second.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import traceback
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from disk.machine_memory import machine_bytes
from itof.arrays import Numbers
from itof.binary_fields import BinaryLayout
from itof.exr.header import ImageFileError
from itof.exr.image import FIELD_OF_VIEW, PROJECTOR, read_image
from itof.files.array_claims import ARRAYS, RefusedError
from itof.files.binary_reading import read_binary
from itof.files.mat_reading import is_hdf5, read_mat
from itof.files.npz_reading import read_npy, read_npz
from itof.files.picture_reading import IMAGE_ENDINGS, read_picture
from itof.files.video_reading import read_video

Contents = tuple[dict[str, Numbers], list[str]]
_CPU_SECONDS = (
    60  # for any file, and one more for every megabyte: reading an honest file takes a tenth of that
)
_WRITE_AGAIN = "write it again with the program that made it"
_OUR_CHANNELS: Final = ("itof.", "direct.", "hidden.")  # of the images that night-render writes


def main() -> None:
    """Write the arrays that the other arguments name, of the file that the first one names, to stdout.

    The second argument is the layout of a file of bare numbers as JSON, or null.
    """
    path, layout, wanted = Path(sys.argv[1]), json.loads(sys.argv[2]), tuple(sys.argv[3:])
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not get between the arrays
    try:
        _limit_itself(path)
        found, names = read_arrays(path, wanted, layout and BinaryLayout(*layout))
    except RefusedError as error:
        _send(out, {"refusal": str(error)})
    else:
        arrays = {
            name: np.asarray(values, values.dtype.newbyteorder("="), order="C")
            for name, values in found.items()
        }
        head = [[name, values.dtype.str, values.shape] for name, values in arrays.items()]
        _send(out, {"arrays": head, "names": names}, *arrays.values())


def _limit_itself(path: Path) -> None:
    """Take no more memory than the machine has, no endless time, and leave no core dump."""
    used = Path("/proc/self/statm")  # of Linux; elsewhere, it may have more already than the limit would be
    if used.exists():
        pages = int(used.read_text(encoding="ascii").split()[0])
        _lower(resource.RLIMIT_AS, pages * os.sysconf("SC_PAGE_SIZE") + machine_bytes())
    _lower(resource.RLIMIT_CPU, _CPU_SECONDS + path.stat().st_size // 10**6)
    _lower(resource.RLIMIT_CORE, 0)


def _lower(limit: int, value: int) -> None:
    hard = resource.getrlimit(limit)[1]
    if hard == resource.RLIM_INFINITY or value < hard:
        resource.setrlimit(limit, (value, hard))


def read_arrays(path: Path, wanted: tuple[str, ...] = ARRAYS, layout: BinaryLayout | None = None) -> Contents:
    """The arrays among `wanted` that a file has, and the names of all that it has.

    Parameters
    ----------
    layout : of a file of bare numbers.

    Raises
    ------
    RefusedError : the file cannot be read, whatever happens; the message is one sentence that names it.
    """
    try:
        return _read(path, wanted) if layout is None else read_binary(path, layout, wanted)
    except RefusedError:
        raise
    except ImageFileError as error:
        raise RefusedError(str(error)) from None
    except MemoryError:
        raise RefusedError(f"{path} does not fit into the memory that is free: write smaller files") from None
    except Exception as error:  # of any kind: only a damaged file can cause it
        if os.environ.get("NIGHT_TRACEBACK"):
            traceback.print_exc()
        reason = f"{type(error).__name__}: {error}"
        raise RefusedError(f"{path} cannot be read: it is damaged ({reason}); write it again") from None


def _read(path: Path, wanted: tuple[str, ...]) -> Contents:
    ending = path.suffix.lower()
    if ending == ".exr":
        return _read_phasors(path) if wanted == ARRAYS else _read_channels(path, wanted)
    if ending == ".npz":
        return read_npz(path, wanted)
    if ending == ".npy":
        return read_npy(path)
    if ending in IMAGE_ENDINGS:
        return read_picture(path)
    if ending == ".mkv":
        return read_video(path, wanted)
    if ending == ".mat" and not is_hdf5(path):
        return read_mat(path, wanted)
    from itof.files.hdf5_reading import read_hdf5

    if ending != ".mat":
        return read_hdf5(path, wanted)
    places = {name: name.replace(".", "/") for name in wanted}  # fields of structures lie in groups
    found, names = read_hdf5(path, tuple(places.values()))
    return {name: found[place] for name, place in places.items() if place in found}, names


def _read_phasors(path: Path) -> Contents:
    image = read_image(path, advice=_WRITE_AGAIN)
    try:
        phasors, frequencies_hz = image.phasors()  # (H, W, F)
    except ImageFileError as error:
        raise RefusedError(f"{path} holds no phasors: {error}") from None
    if PROJECTOR in image.attributes:
        raise RefusedError(
            f"{path} has the light of a projector of its own: networks and fits of the wall know only a "
            "flash at the camera"
        )
    others = [name for name in image.channels if not name.startswith(_OUR_CHANNELS)]
    arrays = {"phasors": phasors, "frequencies_hz": np.array(frequencies_hz)}
    if FIELD_OF_VIEW in image.attributes:
        arrays[FIELD_OF_VIEW] = _number(path, image.attributes[FIELD_OF_VIEW])
    return arrays, [*arrays, *others]


def _number(path: Path, text: str) -> Numbers:
    try:
        return np.array(float(text))
    except ValueError:
        raise RefusedError(f"{path} has a field of view that is no number: {text[:20]!r}") from None


def _read_channels(path: Path, wanted: tuple[str, ...]) -> Contents:
    channels = read_image(path, advice=_WRITE_AGAIN, copies=2).channels  # (H, W) each
    return {name: channels[name] for name in wanted if name in channels}, list(channels)


def _send(out: BinaryIO, head: dict[str, Any], *arrays: Numbers) -> None:
    with out:
        out.write(json.dumps(head).encode("ascii") + b"\n")
        for values in arrays:
            out.write(values.data)
