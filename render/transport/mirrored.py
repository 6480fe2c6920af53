"""Ground truth by the mirror trick: the camera's image of the objects' mirror images in the relay wall.

Source: Caligiuri et al. 2024, sec. 4.1; docs/science/design.md, Scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from itof import DepthMap

if TYPE_CHECKING:
    import mitsuba as mi


def trace_ground_truth(mirrored_scene: mi.Scene, width: int, height: int, frequency_hz: float) -> DepthMap:
    """Depth map (H, W) of the mirrored scene, from one ray per pixel, from the pinhole through its centre.

    A pixel belongs to the object if the first surface its ray meets is the mirror image of a hidden object;
    all other surfaces are background. The mirror image of the middle wall is among them if the scene has it
    (`scenegen.mitsuba_description.mirrored_description`).
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.rays import on_shapes
    from render.transport.lights.hidden_surface import HIDDEN_PREFIX

    sensor = mirrored_scene.sensors()[0]
    index = dr.arange(mi.UInt32, width * height)
    centre = mi.Point2f((index % width + 0.5) / width, (index // width + 0.5) / height)
    ray, _ = sensor.sample_ray(0.0, 0.0, centre, mi.Point2f(0.5))
    ray.o = sensor.world_transform().translation()  # Mitsuba starts at the near clip plane
    hit = mirrored_scene.ray_intersect_preliminary(ray)
    images = [
        shape for shape in mirrored_scene.shapes() if shape.id().startswith(f"mirrored_{HIDDEN_PREFIX}")
    ]
    on_object = on_shapes(hit, images)
    depth = dr.select(on_object, hit.t, 0.0)
    dr.eval(depth, on_object)
    radial_depth_m = np.array(depth, dtype=np.float64).reshape(height, width)
    return DepthMap.of_object(radial_depth_m, np.array(on_object).reshape(height, width), frequency_hz)
