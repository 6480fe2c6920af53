"""Disks that are too small: a limit for this process, or a file system of a given size for a script."""

import contextlib
import functools
import resource
import subprocess


@contextlib.contextmanager
def file_size_limit(size):
    """Let this process write no file above `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@functools.cache
def can_mount():
    """Whether a process of this user may mount a file system of its own."""
    return on_small_disk("/mnt", 64, "true").returncode == 0


def on_small_disk(folder, kilobytes, script):
    """Run a shell script that sees a file system of so many kB at `folder`."""
    mount = f"mount -t tmpfs -o size={kilobytes}k night {folder} && {script}"
    command = ["unshare", "--map-root-user", "--mount", "bash", "-c", mount]
    return subprocess.run(command, capture_output=True, text=True, check=False)
