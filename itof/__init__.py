"""iToF measurements: phasors, phase, depth, network channels, and the EXR files of images and transients.

Imports no other package of NIGHT. `itof.wall`, which is not imported here, finds the relay wall in a
measurement.

Arrays are numpy, image axes are (..., H, W, F) or (..., H, W, T), lengths are metres of *optical path*
(out and back) where a name says `opl`, and metres of depth (half of it) where it says `depth`.
"""

from itof.channels import network_channels, phasors_of_channels, phasors_of_residual, residual_channels
from itof.depth_map import DEPTH_CHANNEL, MASK_CHANNEL, DepthMap
from itof.direct import direct_phasors
from itof.exr import Image, phasor_channels, pixel_types, read_image, write_image
from itof.exr_header import ImageFileError
from itof.exr_library import compressing_with_threads
from itof.exr_transient import MOST_WRITTEN_BYTES, TransientLayout, TransientReader, TransientWriter
from itof.light import (
    SPEED_OF_LIGHT,
    amplitude,
    depth_from_phase,
    phase,
    phase_per_metre,
    phasor_of_return,
    unambiguous_range_m,
)
from itof.measurement import MeasurementMatrix, join_components, phasors, split_components
from itof.pinhole import pixel_rays, points_from_radial, radial_from_z, z_from_radial
from itof.splat import WIDEST_REACH_BINS, Splat, highest_frequency_hz, splat_residue, splat_transfer
from itof.unwrapping import combined_range_m, unwrap_depth
from itof.weighted_reference import SubpixelWeights, weighted_reference

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
    "combined_range_m",
    "compressing_with_threads",
    "depth_from_phase",
    "direct_phasors",
    "highest_frequency_hz",
    "join_components",
    "network_channels",
    "phase",
    "phase_per_metre",
    "phasor_channels",
    "phasor_of_return",
    "phasors",
    "phasors_of_channels",
    "phasors_of_residual",
    "pixel_rays",
    "pixel_types",
    "points_from_radial",
    "radial_from_z",
    "read_image",
    "residual_channels",
    "splat_residue",
    "splat_transfer",
    "split_components",
    "unambiguous_range_m",
    "unwrap_depth",
    "weighted_reference",
    "write_image",
    "z_from_radial",
]
