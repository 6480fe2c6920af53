"""What the camera would measure: transients, phasors and ground truth rendered with Mitsuba 3.

Nothing here loads Mitsuba or sets a variant on import; `select_variant` and `Renderer` do.
"""

from render.backend import BackendError, Device, select_variant
from render.method import Method, View
from render.methods import DEFAULT_METHOD, METHODS
from render.mirrored import GroundTruth, trace_ground_truth
from render.path_tracer import PathTracer
from render.rendering import Renderer, RenderError, RenderSettings

__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "BackendError",
    "Device",
    "GroundTruth",
    "Method",
    "PathTracer",
    "RenderError",
    "RenderSettings",
    "Renderer",
    "View",
    "select_variant",
    "trace_ground_truth",
]
