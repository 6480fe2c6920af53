"""The direct return and the mirrored depth of pixels. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from render.batch.kernels.shadows import FARTHEST_M
from render.batch.kernels.wall import QUAD, Batch, Wall

_TWO_NODES = 3**-0.5  # of Gauss and Legendre on [-1, 1]


class Film:
    """What lines of pixels show of the relay wall: FEW and MANY Gauss lines, then top and bottom of a pixel.

    Attributes
    ----------
    parts : (N, H, FEW + MANY + 2) lines, four numbers each (`render.batch.corners.Corners.visible`).
    lines : (N, H, FEW + MANY + 2) y of the lines on the film z = 1.
    weights : (FEW + MANY,) of the lines.
    half_width : half the number of columns.
    """

    FEW, MANY = 2, 8

    def __init__(
        self, parts: mi.Float, lines: mi.Float, weights: mi.Float, height: mi.UInt32, half_width: mi.Float
    ) -> None:
        self.parts, self.lines, self.weights = parts, lines, weights
        self.height, self.half_width = height, half_width

    def line(
        self, scene: mi.UInt32, row: mi.UInt32, line: mi.UInt32
    ) -> tuple[mi.Float, mi.Vector4f, mi.Float]:
        """y, visible parts and weight of a line of a row of pixels."""
        index = self._index(scene, row, line)
        weight = dr.gather(mi.Float, self.weights, line)
        return dr.gather(mi.Float, self.lines, index), dr.gather(QUAD, self.parts, index), weight

    def is_whole(self, scene: mi.UInt32, row: mi.UInt32, left: mi.Float, right: mi.Float) -> mi.Bool:
        """Whether the lines of a pixel show nothing but the relay wall."""
        whole = mi.Bool(True)
        for line in (0, 1, self.FEW + self.MANY, self.FEW + self.MANY + 1):
            parts = dr.gather(QUAD, self.parts, self._index(scene, row, mi.UInt32(line)))
            whole &= ((parts.x <= left) & (parts.y >= right)) | ((parts.z <= left) & (parts.w >= right))
        return whole

    def _index(self, scene: mi.UInt32, row: mi.UInt32, line: mi.UInt32) -> mi.UInt32:
        return (scene * self.height + row) * (self.FEW + self.MANY + 2) + line


@dr.syntax
def direct_return(
    batch: Batch,
    scene: mi.UInt32,
    row: mi.UInt32,
    column: mi.UInt32,
    pixel: mi.Float,
    film: Film,
) -> tuple[list[mi.Float], list[mi.Float]]:
    """Mean phasor over the part of a pixel that shows the relay wall, times the share of that part.

    A pixel without an edge takes 2 x 2 Gauss nodes, which are exact for cubic polynomials; one with an edge
    takes more rows, each cut exactly at the edge.

    Parameters
    ----------
    pixel : width of a pixel on the film z = 1 of each lane.
    """
    wall, count = Wall(batch, scene), len(batch.phase_per_metre)
    left = (mi.Float(column) - film.half_width) * pixel
    whole = film.is_whole(scene, row, left, left + pixel)
    first = dr.select(whole, mi.UInt32(0), mi.UInt32(film.FEW))
    last = dr.select(whole, mi.UInt32(film.FEW), mi.UInt32(film.FEW + film.MANY))
    re, im = [mi.Float(0) for _ in range(count)], [mi.Float(0) for _ in range(count)]
    line = mi.UInt32(first)
    while line < last:
        y, parts, weight = film.line(scene, row, line)
        part = mi.UInt32(0)
        while part < 2:
            begin = dr.maximum(left, dr.select(part == 0, parts.x, parts.z))
            end = dr.minimum(left + pixel, dr.select(part == 0, parts.y, parts.w))
            node = mi.UInt32(0)
            while (node < 2) & (end > begin):
                away = dr.select(node == 0, -_TWO_NODES, _TWO_NODES)
                ray = mi.Vector3f((begin + end) / 2 + away * (end - begin) / 2, y, 1)
                distance = dr.norm(ray) / dr.dot(ray, wall.plane)
                back = -dr.normalize(ray)
                at = mi.Point3f(-back * distance)
                diffuse, gloss = wall.towards_camera(at, distance)
                share = weight * (end - begin) / (2 * pixel)
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
