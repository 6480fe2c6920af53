"""Loads Blender as a Python module: quietly, with a settings folder of its own.

All modules named ``blender...`` take `bpy`, `bmesh` and `mathutils` from here, so that the steps below always
come first.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from processes.deferred_signals import deferred_signals
from processes.silence import silenced
from scenegen.making.missing_blender import BlenderError

STDOUT, STDERR = 1, 2  # Blender's C code prints to these file descriptors

# Blender writes settings into the home folder unless this variable names another one; it is read at import.
_SETTINGS = tempfile.TemporaryDirectory(prefix="night-blender-")
os.environ.setdefault("BLENDER_USER_RESOURCES", _SETTINGS.name)
try:
    with deferred_signals(), silenced(STDOUT):  # Blender loses an exception that comes while it starts
        import bpy
except ImportError as error:
    raise BlenderError(
        f"Blender cannot be loaded ({error}): install the system libraries of .ci/system_libraries"
    ) from None
# Blender's own clean-up at the end of a process can wait forever: it destroys a condition variable on which
# one of its threads still waits. C calls the handler that is registered last first. This one leaves at once,
# with the exit status; Python has run its own exit handlers and flushed its files before.
_LIBC = ctypes.CDLL(None)
_LIBC.on_exit(_LIBC._exit, None)
with deferred_signals(), silenced(STDOUT):  # bpy makes these modules available
    import bmesh
    from mathutils import Matrix
    from mathutils import Vector as BlenderVector


@atexit.register
def _remove_session_folder() -> None:
    """Remove Blender's folder for temporary files, which that clean-up would have removed."""
    with suppress(OSError):  # it is not empty, or there is none
        Path(bpy.app.tempdir).rmdir()


__all__ = ["STDERR", "STDOUT", "BlenderVector", "Matrix", "bmesh", "bpy", "empty_blender"]


@cache
def empty_blender() -> None:
    """Remove the objects that Blender starts with.

    Runs once in a process: a second reset would also remove the meshes of another `BlenderMaker`.
    """
    with deferred_signals(), silenced(STDOUT):
        bpy.ops.wm.read_factory_settings(use_empty=True)
