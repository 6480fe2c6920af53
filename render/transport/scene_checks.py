"""Checks, with a few rays, that the many-light method can render a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from disk import NightError
from render.transport.lights.hidden_surface import hidden_shapes

if TYPE_CHECKING:
    import mitsuba as mi

_RAYS = 4096
_PIXELS = (64, 48)
USE_PATH = "render this scene with --method path"


class SceneError(NightError):
    """The rendering method cannot render this scene."""


def check_many_light_scene(scene: mi.Scene, has_hidden: bool) -> None:
    """Refuse a scene that the many-light method would render wrongly.

    Raises
    ------
    SceneError : no surface is lit, the lit wall is a perfect mirror, or a hidden object is visible from the
        camera or an emitter.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.arrays import upload
    from render.transport.kernels.rays import camera_hits
    from render.transport.lights.arrivals import emitted_rays

    lit_any = smooth_any = False
    for emitter in scene.emitters():
        ray, flux = emitted_rays(emitter, _RAYS, 0, dr.arange(mi.UInt32, _RAYS))
        si = scene.ray_intersect(ray)
        lit = si.is_valid() & (flux.x > 0)
        smooth = lit & mi.has_flag(si.bsdf(ray).flags(), mi.BSDFFlags.Smooth)
        dr.eval(lit, smooth, si.shape)
        lit_any |= bool(np.array(lit).any())
        smooth_any |= bool(np.array(smooth).any())
        if has_hidden and _meets_hidden(scene, si)[np.array(lit)].any():
            raise SceneError(
                f"an emitter lights the hidden object directly, which many-light cannot render: {USE_PATH}"
            )
    if not lit_any:
        raise SceneError("the emitters light nothing in the scene: turn them towards the relay wall")
    if has_hidden and not smooth_any:
        raise SceneError(f"the lit wall is a perfect mirror, which many-light cannot render: {USE_PATH}")
    width, height = _PIXELS
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    si = camera_hits(scene, upload(x), upload(y))
    dr.eval(si.shape)
    if has_hidden and _meets_hidden(scene, si).any():
        raise SceneError(
            f"the camera sees the hidden object directly, which many-light cannot render: {USE_PATH}"
        )


def _meets_hidden(scene: mi.Scene, si: mi.SurfaceInteraction3f) -> NDArray[np.bool_]:
    from render.transport.kernels.rays import on_shapes

    return np.array(on_shapes(si, hidden_shapes(scene)))
