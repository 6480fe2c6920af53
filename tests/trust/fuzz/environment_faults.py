"""Faults of a command's environment: a full disk, a folder without write permission, closed streams.

Each is a function, or a class with its parameters, that a child calls before its command
(``before`` of `forked.Forks.start`).
"""

import ctypes
import os
import resource
import sys
from dataclasses import dataclass


@dataclass(frozen=True)
class LargestFile:
    """No file may become larger, as on a disk that is full or a quota; needs no rights."""

    size: int

    def __call__(self) -> None:
        """Set the limit; Python ignores the signal that comes with it."""
        resource.setrlimit(resource.RLIMIT_FSIZE, (self.size, resource.RLIM_INFINITY))


def few_open_files():
    """At most 64 open files."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))


@dataclass(frozen=True)
class ClosedStreams:
    """Some of the standard streams are closed, as by ``2>&-`` of a shell."""

    numbers: tuple[int, ...]

    def __call__(self) -> None:
        """Close them, and leave Python's streams as it has them after such a start."""
        for number in self.numbers:
            os.close(number)
            setattr(sys, ("stdin", "stdout", "stderr")[number], None)


def no_home():
    """Neither HOME nor another variable names a folder for settings, and the user has no entry."""
    for name in ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "USER", "LOGNAME"):
        os.environ.pop(name, None)


def home_is_gone():
    """HOME names a folder that does not exist and cannot be made."""
    os.environ["HOME"] = "/proc/nobody"


def permissions_count():
    """Root gives up the right to ignore the permissions of files; others do not have it."""
    if os.geteuid() == 0:
        header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # _LINUX_CAPABILITY_VERSION_3, this process
        sets = (ctypes.c_uint32 * 6)()  # effective, permitted and inheritable capabilities, twice 32 bits
        assert ctypes.CDLL(None).capset(header, sets) == 0
