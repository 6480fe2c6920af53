"""The direct return and the mirrored depth of pixels. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from render.batch.kernels.shadows import FARTHEST_M
from render.batch.kernels.wall import QUAD, Batch, Wall

_TWO_NODES = 3**-0.5  # of Gauss and Legendre on [-1, 1]


@dr.syntax
def direct_return(
    batch: Batch,
    scene: mi.UInt32,
    left: mi.Float,
    size: mi.Float,
    lines: mi.Float,
    first: mi.UInt32,
    last: mi.UInt32,
) -> tuple[list[mi.Float], list[mi.Float]]:
    """Mean phasor over the part of a pixel that shows the relay wall, times the share of that part.

    Each free part of a line has two Gauss nodes.

    Parameters
    ----------
    left, size : of a pixel on the film z = 1.
    lines : `render.walls.pixel_lines.PixelLines.lines`; a pixel has those from `first` to before `last`.
    """
    wall, count = Wall(batch, scene), len(batch.phase_per_metre)
    re, im = [mi.Float(0) for _ in range(count)], [mi.Float(0) for _ in range(count)]
    line = mi.UInt32(first)
    while line < last:
        head, parts = dr.gather(QUAD, lines, 2 * line), dr.gather(QUAD, lines, 2 * line + 1)
        part = mi.UInt32(0)
        while part < 2:
            begin = dr.maximum(left, dr.select(part == 0, parts.x, parts.z))
            end = dr.minimum(left + size, dr.select(part == 0, parts.y, parts.w))
            node = mi.UInt32(0)
            while (node < 2) & (end > begin):
                away = dr.select(node == 0, -_TWO_NODES, _TWO_NODES)
                ray = mi.Vector3f((begin + end) / 2 + away * (end - begin) / 2, head.x, 1)
                distance = dr.norm(ray) / dr.dot(ray, wall.plane)
                back = -dr.normalize(ray)
                at = mi.Point3f(-back * distance)
                diffuse, gloss = wall.towards_camera(at, distance)
                share = head.y * (end - begin) / (2 * size)
                value = share * wall.lobe(back, back, diffuse, gloss) * distance / at.z**3
                for f in range(count):
                    sine, cosine = dr.sincos(batch.phase_per_metre[f] * (2 * distance))
                    re[f] += value * cosine
                    im[f] += value * sine
                node += 1
            part += 1
        line += 1
    return re, im


@dr.syntax
def mirrored_depth(
    batch: Batch,
    scene: mi.UInt32,
    ray: mi.Vector3f,
    first: mi.UInt32,
    last: mi.UInt32,
    has_mirrored_wall: mi.Bool,
) -> mi.Float:
    """Radial depth of the mirror image of the objects along unit rays of the camera, metres; 0 beside it.

    The image is hidden by the middle wall, and by its mirror image where the scene has that.
    """
    wall = Wall(batch, scene)
    mirrored = mi.Point3f(wall.plane * (2 / dr.squared_norm(wall.plane)))
    turned = ray - 2 * dr.dot(ray, wall.normal) * wall.normal
    nearest = mi.Float(FARTHEST_M)
    index = mi.UInt32(first)
    while index < last:
        nearest = dr.minimum(nearest, batch.shadows.depth(index, mirrored, turned))
        index += 1
    found = nearest < FARTHEST_M
    found &= ~wall.hides(mi.Point3f(0), mi.Point3f(nearest * ray))
    found &= ~(has_mirrored_wall & wall.hides(mirrored, mirrored + nearest * turned))
    return dr.select(found, nearest, 0)
