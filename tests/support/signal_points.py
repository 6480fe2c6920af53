"""SIGTERM at chosen points of a command of ``night-render``, where a C library calls Python back.

As a program (``signal_points.py STRIDE OUT WORD...``), runs the command of the words again and again, each
time in a copy of this process and with the signal before a later one of these calls, STRIDE apart. Writes a
line for each run: "ended", its exit code, and how many files it has left in the folder OUT, which is emptied
before. In the last run, the signal never comes.
"""

import os
import shutil
import signal
import sys
from pathlib import Path

import zarr

import cli
from render.products.deferred_error_file import DeferredErrorFile

POINTS = [(DeferredErrorFile, name) for name in ("seek", "write", "readinto", "truncate", "close")]
POINTS += [(zarr.Array, "__setitem__"), (zarr.Group, "create_array")]


def signalled_before(number, words):
    """Exit code of the command with these words, in a copy of this process; and whether the signal came."""
    child = os.fork()
    if child == 0:
        calls = []

        def counted(method):
            def call(*arguments, **options):
                calls.append(method)
                if len(calls) == number:
                    signal.raise_signal(signal.SIGTERM)
                return method(*arguments, **options)

            return call

        for cls, name in POINTS:
            setattr(cls, name, counted(getattr(cls, name)))
        try:
            cli.night_render(words)
        except SystemExit as end:
            os._exit(int(end.code or 0))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    stride, out, words = int(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    number, code = 1, None
    while code != 0:
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        code = signalled_before(number, words)
        sys.stdout.write(f"ended {code} {len(list(out.iterdir()))}\n")
        sys.stdout.flush()
        number += stride
