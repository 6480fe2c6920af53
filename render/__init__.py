"""What the camera would measure: transients, phasors and ground truth rendered with Mitsuba 3.

Nothing here loads Mitsuba or sets a variant on import; `select_variant` and `Renderer` do.
"""

from render.backend import BackendError, Device, select_variant
from render.many_light import ManyLight
from render.method import Method, MethodOptions, PhasorImage, View
from render.methods import DEFAULT_METHOD, METHODS
from render.mirrored import GroundTruth, trace_ground_truth
from render.path_tracer import PathTracer
from render.rendering import PRODUCTS, Product, Renderer, RenderError, RenderSettings
from render.scene_checks import SceneError

__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "PRODUCTS",
    "BackendError",
    "Device",
    "GroundTruth",
    "ManyLight",
    "Method",
    "MethodOptions",
    "PathTracer",
    "PhasorImage",
    "Product",
    "RenderError",
    "RenderSettings",
    "Renderer",
    "SceneError",
    "View",
    "select_variant",
    "trace_ground_truth",
]
