"""Ground truth by the mirror trick: what the camera would see if the relay wall were an ideal mirror."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import phasor_of_return

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class GroundTruth:
    """Depth map of the mirrored scene, one ray through every pixel centre.

    Attributes
    ----------
    radial_depth_m : (H, W) float64, along the ray from the pinhole; 0 on the background.
    mask : (H, W) bool, True on the hidden object.
    """

    radial_depth_m: NDArray[np.float64]
    mask: NDArray[np.bool_]

    def phasor(self, frequency_hz: float) -> NDArray[np.complex128]:
        """(H, W) network target: amplitude 1 on the object and 0 elsewhere."""
        return np.where(self.mask, phasor_of_return(self.radial_depth_m, frequency_hz), 0.0)


def trace_ground_truth(mirrored_scene: mi.Scene, width: int, height: int) -> GroundTruth:
    """Intersect one ray per pixel centre with the mirrored scene.

    A pixel belongs to the object when the first surface its ray meets is a shape whose id starts with
    ``mirrored_``; all other surfaces are background.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import on_shapes

    sensor = mirrored_scene.sensors()[0]
    index = dr.arange(mi.UInt32, width * height)
    centre = mi.Point2f((index % width + 0.5) / width, (index // width + 0.5) / height)
    ray, _ = sensor.sample_ray(0.0, 0.0, centre, mi.Point2f(0.5))
    ray.o = sensor.world_transform().translation()  # Mitsuba starts at the near clip plane
    hit = mirrored_scene.ray_intersect_preliminary(ray)
    shapes = [shape for shape in mirrored_scene.shapes() if shape.id().startswith("mirrored_")]
    on_object = on_shapes(hit, shapes)
    depth = dr.select(on_object, hit.t, 0.0)
    dr.eval(depth, on_object)
    return GroundTruth(
        np.array(depth, dtype=np.float64).reshape(height, width), np.array(on_object).reshape(height, width)
    )
