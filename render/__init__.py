"""What the camera would measure: transients, phasors and ground truth rendered with Mitsuba 3.

Nothing here loads Mitsuba or sets a variant on import; `select_variant` and `Renderer` do.
"""

from render.backend import BackendError, Device, select_variant
from render.claims import OtherRunError
from render.clusters import ClusterError, batch_cluster
from render.contact_sheet import choose_scenes
from render.conversion import ExportError, convert_to_itof, open_transient, shrink_dataset
from render.dataset_card import CardError
from render.inventory import Inventory, State
from render.many_light import ManyLight
from render.method import Method, MethodOptions, PhasorImage, View
from render.methods import DEFAULT_METHOD, METHODS
from render.mirrored import GroundTruth, trace_ground_truth
from render.movie import MovieOptions, write_movie
from render.path_tracer import PathTracer
from render.preview import check_preview, meshes_in, write_preview
from render.queue import QueueError
from render.rendering import Renderer
from render.run import RunOptions, RunResult, render_dataset, settings_for
from render.scene_checks import SceneError
from render.settings import PRODUCTS, Product, RenderError, RenderSettings
from render.status import Status, read_status
from render.tal_export import export_tal
from render.verification import Verification, verify

__all__ = [
    "DEFAULT_METHOD",
    "METHODS",
    "PRODUCTS",
    "BackendError",
    "CardError",
    "ClusterError",
    "Device",
    "ExportError",
    "GroundTruth",
    "Inventory",
    "ManyLight",
    "Method",
    "MethodOptions",
    "MovieOptions",
    "OtherRunError",
    "PathTracer",
    "PhasorImage",
    "Product",
    "QueueError",
    "RenderError",
    "RenderSettings",
    "Renderer",
    "RunOptions",
    "RunResult",
    "SceneError",
    "State",
    "Status",
    "Verification",
    "View",
    "batch_cluster",
    "check_preview",
    "choose_scenes",
    "convert_to_itof",
    "export_tal",
    "meshes_in",
    "open_transient",
    "read_status",
    "render_dataset",
    "select_variant",
    "settings_for",
    "shrink_dataset",
    "trace_ground_truth",
    "verify",
    "write_movie",
    "write_preview",
]
