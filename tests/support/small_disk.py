"""A disk of any size: a tmpfs, which root may mount."""

import subprocess
from contextlib import contextmanager

import pytest


@contextmanager
def small_disk(folder):
    """A tmpfs mounted on `folder`; yields a function that sets its size in bytes."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", folder], capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip("mounting a small disk needs root")
    try:
        yield lambda size: subprocess.run(
            ["mount", "-o", f"remount,size={size}", folder], check=True, capture_output=True
        )
    finally:
        subprocess.run(["umount", "-l", folder], check=True, capture_output=True)
