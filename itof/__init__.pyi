from .capture.checking import check_capture
from .capture.importing import import_capture
from .channels import network_channels, residual_channels
from .direct import direct_phasors
from .exr.depth_map import DEPTH_CHANNEL, MASK_CHANNEL, DepthMap
from .exr.header import ImageFileError
from .exr.image import Image, phasor_channels, pixel_types, read_image, write_image
from .exr.library import compressing_with_threads
from .exr.transient import MOST_WRITTEN_BYTES, TransientLayout, TransientReader, TransientWriter
from .light import (
    SPEED_OF_LIGHT,
    amplitude,
    depth_from_phase,
    phase,
    phase_per_metre,
    phasor_of_return,
    unambiguous_range_m,
)
from .measurement import MeasurementMatrix, phasors
from .pinhole import pixel_rays, points_from_radial, radial_from_z, z_from_radial
from .splat import WIDEST_REACH_BINS, Splat, highest_frequency_hz, splat_residue, splat_transfer
from .unwrapping import combined_range_m, unwrap_depth
from .weighted_reference import SubpixelWeights, weighted_reference

__all__ = [
    "DEPTH_CHANNEL",
    "MASK_CHANNEL",
    "MOST_WRITTEN_BYTES",
    "SPEED_OF_LIGHT",
    "WIDEST_REACH_BINS",
    "DepthMap",
    "Image",
    "ImageFileError",
    "MeasurementMatrix",
    "Splat",
    "SubpixelWeights",
    "TransientLayout",
    "TransientReader",
    "TransientWriter",
    "amplitude",
    "check_capture",
    "combined_range_m",
    "compressing_with_threads",
    "depth_from_phase",
    "direct_phasors",
    "highest_frequency_hz",
    "import_capture",
    "network_channels",
    "phase",
    "phase_per_metre",
    "phasor_channels",
    "phasor_of_return",
    "phasors",
    "pixel_rays",
    "pixel_types",
    "points_from_radial",
    "radial_from_z",
    "read_image",
    "residual_channels",
    "splat_residue",
    "splat_transfer",
    "unambiguous_range_m",
    "unwrap_depth",
    "weighted_reference",
    "write_image",
    "z_from_radial",
]
