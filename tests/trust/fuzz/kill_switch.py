"""A command kills itself before one of its changes of the disk, of which Python's audit events tell."""

import itertools
import os
import signal
import sys
from dataclasses import dataclass

_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.truncate", "os.link"}
_CHANGES |= {"fcntl.flock", "ctypes.dlsym"}  # locks; calls to the system that Python does not know
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_found = []


@dataclass(frozen=True)
class KillBefore:
    """Kills this process, and all that it started, before the change with this number."""

    number: int

    def __call__(self) -> None:
        """Begin to count."""
        numbers = itertools.count()

        def hook(event, arguments):
            if _is_change(event, arguments) and next(numbers) == self.number:
                os.killpg(os.getpgid(0), signal.SIGKILL)

        sys.addaudithook(hook)


def count_changes():
    """Begin to count the changes of the disk by this process."""

    def hook(event, arguments):
        if _is_change(event, arguments):
            _found.append(event)

    sys.addaudithook(hook)


def changes():
    """How many changes there were since `count_changes`."""
    return len(_found)


def _is_change(event, arguments):
    if event == "open":
        return isinstance(arguments[2], int) and bool(arguments[2] & _WRITING)
    return event in _CHANGES
