"""The error of a machine on which Blender does not start; apart from Blender: a worker can send it."""

from __future__ import annotations

from disk.night_error import NightError


class BlenderError(NightError):
    """Blender does not work on this machine."""
