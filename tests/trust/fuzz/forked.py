"""Commands in children of a process that has everything imported (`imported`).

A command that starts as a process of its own imports for seconds; a fork takes milliseconds. A crash stays in
the child. The standard library's fork server is that process.
"""

import atexit
import ctypes
import json
import multiprocessing
import os
import resource
import signal
import sys
import threading
import traceback
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from unittest import mock

MEMORY_BYTES = 16 * 2**30  # address space of a child: protects the machine from a size that a file claims
HANG_S = 120  # far more than any of these commands takes
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : exit code; None after a signal.
    signal : its name, or ``hang`` when the command was killed after HANG_S; None after an exit.
    out, err : all of stdout and stderr, what C libraries print included.
    peak_bytes : largest resident memory, of the child or of a process that it started; 0 after a signal.
    after : what `after` of `start` returned; None if the command did not end with exit code 0.
    """

    code: int | None
    signal: str | None
    out: str
    err: str
    peak_bytes: int = 0
    after: object = None


class Forks:
    """The fork server; it ends with this process."""

    def __init__(self):
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["__main__", "imported"])
        # Python 3.11 does not give the server our sys.path, and ignores modules that it does not find. Ours
        # may have what Blender puts there when it is loaded, and Blender cannot be loaded from there.
        here = Path(__file__).parent
        folders = os.pathsep.join(map(str, (here, here.parents[1] / "support")))
        with mock.patch.dict(os.environ, ONE_THREAD, PYTHONPATH=folders):
            first = self._context.Process(target=_check_threads)
            first.start()
        first.join()
        assert first.exitcode == 0, "the imports of `imported` failed, or they started a thread"

    def start(self, words, folder, *, before=None, after=None):
        """Start a command in a child, a process with its own process group.

        Parameters
        ----------
        words : the command and its arguments.
        folder : working directory. ``../home`` is the child's HOME, and the folder ``../private`` holds its
            TMPDIR and what it prints.
        before, after : functions of a module, or `functools.partial` of them, called in the child: before the
            command (limits, kill switches), and after one that ended with exit code 0.
        """
        child = self._context.Process(target=_run, args=([*map(str, words)], str(folder), before, after))
        with _ONE_AT_A_TIME:
            child.start()
        return child

    def run(self, words, folder, **options):
        """Run a command in a child to its end."""
        return ended(self.start(words, folder, **options), folder)


def ended(child, folder):
    """Wait for the end of a child of `Forks.start`."""
    hung = not wait([child.sentinel], HANG_S)
    if hung:
        kill_group(child.pid)
        wait([child.sentinel])
    with _ONE_AT_A_TIME:
        child.join()
        code = child.exitcode
        child.close()
    private = folder.parent / "private"
    out, err = ((private / name).read_bytes().decode(errors="backslashreplace") for name in _STREAMS)
    if code < 0:
        return Ended(None, "hang" if hung else signal.Signals(-code).name, out, err)
    told = json.loads((private / _TOLD).read_text())
    return Ended(code, None, out, err, **told)


def kill_group(pid):
    """Kill a child and all processes that it started."""
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


_STREAMS, _TOLD = ("stdout", "stderr"), "told"
_ONE_AT_A_TIME = threading.Lock()  # a start asks for the exit codes of all children, which can be read once


def _check_threads():
    os._exit("imported" not in sys.modules or sys.modules["imported"].THREADS != 1)


def _run(words, folder, before, after):
    """The child. It never returns: its exit runs the handlers of C libraries, where some of them crash."""
    code, told = 70, {}
    private = Path(folder).parent / "private"
    try:
        _settle(Path(folder), private)
        if before is not None:
            before()
        code = _invoke(words)
        told = {"after": after() if after is not None and code == 0 else None}
    except BaseException:
        traceback.print_exc()
    with suppress(BaseException):
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    peak = max(resource.getrusage(who).ru_maxrss for who in whose) * 1024
    (private / _TOLD).write_text(json.dumps({"peak_bytes": peak, **told}))
    _close_hdf5()
    os._exit(code)


def _settle(folder, private):
    """Streams, process group, working directory, environment and limits of the child."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, name in enumerate(_STREAMS, start=1):
        descriptor = os.open(private / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.setsid()  # from here on it may be killed, and what it printed is there
    sys.path[:] = sys.modules["imported"].SYS_PATH  # not that of the tests: see `Forks`
    os.chdir(folder)
    os.environ.update(HOME=str(folder.parent / "home"), TMPDIR=str(private))
    for name in ("PYTHONPATH", "PYTEST_CURRENT_TEST"):
        os.environ.pop(name, None)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _invoke(words):
    """Run the program as it is installed, or a command of `reading`; its exit code."""
    import reading

    import night_nlos

    sys.argv = words
    name = words[0].replace("-", "_")
    try:
        (getattr(night_nlos, name, None) or getattr(reading, name))()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def _close_hdf5():
    """What a process does with HDF5 at its exit; the handlers of all C libraries together take 0.2 s."""
    import h5py.h5

    ctypes.CDLL(h5py.h5.__file__).H5close()


def permissions_count():
    """Root gives up the right to ignore the permissions of files; others do not have it."""
    if os.geteuid() == 0:
        header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # _LINUX_CAPABILITY_VERSION_3, this process
        sets = (ctypes.c_uint32 * 6)()  # effective, permitted and inheritable capabilities, twice 32 bits
        assert ctypes.CDLL(None).capset(header, sets) == 0
