"""iToF measurements: phasors, phase, depth, network channels, and the EXR files of images and transients.

Imports no other package of NIGHT.

Arrays are numpy, image axes are (..., H, W, F) or (..., H, W, T), lengths are metres of *optical path*
(out and back) where a name says `opl`, and metres of depth (half of it) where it says `depth`.
"""

from itof.channels import network_channels, phasors_of_channels, phasors_of_residual, residual_channels
from itof.depth_map import DEPTH_CHANNEL, MASK_CHANNEL, DepthMap
from itof.direct import direct_phasors
from itof.exr import (
    Image,
    ImageFileError,
    TransientLayout,
    TransientReader,
    TransientWriter,
    phasor_channels,
    pixel_types,
    read_image,
    write_image,
)
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
from itof.unwrapping import combined_range_m, unwrap_depth

__all__ = [
    "DEPTH_CHANNEL",
    "MASK_CHANNEL",
    "SPEED_OF_LIGHT",
    "DepthMap",
    "Image",
    "ImageFileError",
    "MeasurementMatrix",
    "TransientLayout",
    "TransientReader",
    "TransientWriter",
    "amplitude",
    "combined_range_m",
    "depth_from_phase",
    "direct_phasors",
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
    "split_components",
    "unambiguous_range_m",
    "unwrap_depth",
    "write_image",
    "z_from_radial",
]
