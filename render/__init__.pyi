from .backend import select_variant
from .farm.run import RunOptions, render_dataset
from .farm.status import read_status
from .mirror_panels import write_mirror_panels
from .pairs.captured_corner import captured_corner, write_captured_corner
from .pairs.pairs import write_pairs
from .products.conversion import convert_to_itof, open_transient
from .products.dataset_export import export_dataset
from .products.movie import write_movie
from .products.preview import write_preview
from .products.tal_export import export_tal
from .products.transient_plot import write_transient_plot
from .products.verification import verify
from .rendering import Renderer
from .settings import RenderSettings, settings_for

__all__ = [
    "RenderSettings",
    "Renderer",
    "RunOptions",
    "captured_corner",
    "convert_to_itof",
    "export_dataset",
    "export_tal",
    "open_transient",
    "read_status",
    "render_dataset",
    "select_variant",
    "settings_for",
    "verify",
    "write_captured_corner",
    "write_mirror_panels",
    "write_movie",
    "write_pairs",
    "write_preview",
    "write_transient_plot",
]
