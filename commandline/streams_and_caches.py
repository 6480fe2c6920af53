"""Open standard streams, and a place for caches, before a program imports anything that computes."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from pathlib import Path

from disk.private_folder import private_folder

_STDIN, _STDOUT, _STDERR = range(3)
# Environment variables that name folders for caches, and the folders that are used in place of the home.
_CACHES = {"DRJIT_CACHE_DIR": "drjit", "MPLCONFIGDIR": "matplotlib"}
# Without these, libraries leave something in the folder for temporary files: PyTorch the empty cache of a
# compiler that NIGHT does not use, so any folder that exists will do, and ONNX Runtime the id of a user whose
# use it reports.
_NOTHING_LEFT = {"TORCHINDUCTOR_CACHE_DIR": os.sep, "ORT_DISABLE_TELEMETRY": "1"}


def prepare_process() -> None:
    """Open closed standard streams, and find a place for caches where there is no home folder.

    Processes that this one starts inherit both.
    """
    _open_standard_streams()
    for variable, value in _NOTHING_LEFT.items():
        os.environ.setdefault(variable, value)
    if not _has_home():
        _move_caches()


def _open_standard_streams() -> None:
    """Open the streams that were closed, as by ``2>&-``, on the null device.

    Otherwise the next file that is opened, such as a data file, would get their numbers, and what libraries
    print would be written into it.
    """
    descriptor = os.open(os.devnull, os.O_RDWR)
    while descriptor <= _STDERR:
        os.set_inheritable(descriptor, True)
        descriptor = os.open(os.devnull, os.O_RDWR)
    os.close(descriptor)
    # Python has set the streams that it found closed to None.
    sys.stdin = sys.stdin or os.fdopen(_STDIN, encoding="utf-8", closefd=False)
    sys.stdout = sys.stdout or os.fdopen(_STDOUT, "w", encoding="utf-8", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(_STDERR, "w", encoding="utf-8", closefd=False)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as on stderr, letters that it has not


def _has_home() -> bool:
    """Whether libraries can write into the home folder."""
    home = os.environ.get("HOME")
    return bool(home) and os.access(str(home), os.W_OK | os.X_OK)


def _move_caches() -> None:
    """Put caches into a private folder, unless the environment names a place."""
    with suppress(OSError):  # without caches, programs are only slower
        folder = private_folder()
        for variable, name in _CACHES.items():
            if variable not in os.environ:
                place = Path(folder, name)
                place.mkdir(exist_ok=True)
                os.environ[variable] = str(place)
