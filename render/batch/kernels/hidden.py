"""The light of three bounces. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from render.batch.kernels.shadows import in_shadow
from render.batch.kernels.wall import QUAD, Batch, Wall


def wall_records(batch: Batch, scene: mi.UInt32, at: mi.Point3f) -> mi.Float:
    """Eight numbers of wall points: place, distance | factors of `Wall.towards_camera`, two spare."""
    distance = dr.norm(at)
    diffuse, gloss = Wall(batch, scene).towards_camera(at, distance)
    records = dr.zeros(mi.Float, 8 * dr.width(at))
    index = dr.arange(mi.UInt32, dr.width(at)) * 8
    for place, value in enumerate((at.x, at.y, at.z, distance, diffuse, gloss)):
        dr.scatter(records, value, index + place)
    return records


def _exchanged(
    batch: Batch,
    wall: Wall,
    scene: mi.UInt32,
    one: mi.Vector4f,
    two: mi.Vector4f,
    point: mi.Point3f,
    facing: mi.Vector3f,
    lifted: mi.Point3f,
    own: mi.UInt32,
) -> tuple[mi.Float, mi.Float]:
    """Strength of the way between a wall point's record and a surface point, 1/m² sr, and its length."""
    at = mi.Point3f(one.x, one.y, one.z)
    gap = point - at
    squared = dr.squared_norm(gap)
    inverse = dr.rsqrt(squared)
    to = gap * inverse
    cosine = -dr.dot(to, facing)
    value = wall.lobe(-at / one.w, to, two.x, two.y) * cosine * dr.square(inverse)
    lit = (cosine > 0) & (value > 0) & ~wall.hides(at, point)
    lit &= ~in_shadow(batch.shadows, scene, lifted, own, at - lifted, lit)
    return dr.select(lit, value, 0), squared * inverse


@dr.syntax
def irradiance(
    batch: Batch,
    scene: mi.UInt32,
    surface: mi.Float,
    own: mi.UInt32,
    index: mi.UInt32,
    film: mi.Float,
    flux: mi.Float,
    first: mi.UInt32,
    last: mi.UInt32,
) -> tuple[list[mi.Float], list[mi.Float]]:
    """Complex irradiance of surface points, for each frequency: a sum over the film points of their scene.

    `own` is the convex solid on which each surface point is, and which hides nothing from it.
    """
    wall = Wall(batch, scene)
    one, two = dr.gather(QUAD, surface, 2 * index), dr.gather(QUAD, surface, 2 * index + 1)
    point, facing = mi.Point3f(one.x, one.y, one.z), mi.Vector3f(two.x, two.y, two.z)
    lifted, its = point + two.w * facing, dr.gather(mi.UInt32, own, index)
    count = len(batch.phase_per_metre)
    re, im = [mi.Float(0) for _ in range(count)], [mi.Float(0) for _ in range(count)]
    place = mi.UInt32(first)
    while place < last:
        one_there, two_there = dr.gather(QUAD, film, 2 * place), dr.gather(QUAD, film, 2 * place + 1)
        value, length = _exchanged(batch, wall, scene, one_there, two_there, point, facing, lifted, its)
        value *= dr.gather(mi.Float, flux, place)
        for f in range(count):
            sine, cosine = dr.sincos(batch.phase_per_metre[f] * (length + one_there.w))
            re[f] += value * cosine
            im[f] += value * sine
        place += 1
    return re, im


def sent(real: list[mi.Float], imaginary: list[mi.Float], reflecting: mi.Float) -> mi.Float:
    """What surface points send: Re and Im by frequency, side by side, from their irradiance.

    `reflecting` is the area of each point times its reflectance.
    """
    dr.eval(real, imaginary)  # once: each scatter is a kernel of its own
    count = len(real)
    index = dr.arange(mi.UInt32, dr.width(reflecting)) * (2 * count)
    power = dr.zeros(mi.Float, 2 * count * dr.width(reflecting))
    for f, (re, im) in enumerate(zip(real, imaginary, strict=True)):
        dr.scatter(power, re * reflecting * dr.inv_pi, index + 2 * f)
        dr.scatter(power, im * reflecting * dr.inv_pi, index + (2 * f + 1))
    return power


@dr.syntax
def over_direct(
    batch: Batch,
    scene: mi.UInt32,
    lattice: mi.Float,
    index: mi.UInt32,
    surface: mi.Float,
    own: mi.UInt32,
    sent: mi.Float,
    first: mi.UInt32,
    last: mi.UInt32,
) -> tuple[list[mi.Float], list[mi.Float], mi.Float]:
    """Hidden light of wall points over their direct light: a sum over the surface points of their scene.

    Returned are Re and Im by frequency, and the direct light as `direct` has it. `own` is as for
    `irradiance`, `sent` are Re and Im of what each surface point sends, by frequency.
    """
    wall = Wall(batch, scene)
    one, two = dr.gather(QUAD, lattice, 2 * index), dr.gather(QUAD, lattice, 2 * index + 1)
    count = len(batch.phase_per_metre)
    re, im = [mi.Float(0) for _ in range(count)], [mi.Float(0) for _ in range(count)]
    place = mi.UInt32(first)
    while place < last:
        one_there, two_there = dr.gather(QUAD, surface, 2 * place), dr.gather(QUAD, surface, 2 * place + 1)
        point = mi.Point3f(one_there.x, one_there.y, one_there.z)
        facing = mi.Vector3f(two_there.x, two_there.y, two_there.z)
        lifted, its = point + two_there.w * facing, dr.gather(mi.UInt32, own, place)
        value, length = _exchanged(batch, wall, scene, one, two, point, facing, lifted, its)
        for f in range(count):
            sine, cosine = dr.sincos(batch.phase_per_metre[f] * (length - one.w))
            a = dr.gather(mi.Float, sent, (place * count + f) * 2)
            b = dr.gather(mi.Float, sent, (place * count + f) * 2 + 1)
            re[f] += value * (cosine * a - sine * b)
            im[f] += value * (cosine * b + sine * a)
        place += 1
    direct = _direct(wall, one, two)
    seen = direct > 0  # else the camera does not see the wall there
    re, im = ([dr.select(seen, each / direct, 0) for each in part] for part in (re, im))
    return re, im, direct


def direct(batch: Batch, scene: mi.UInt32, lattice: mi.Float, index: mi.UInt32) -> mi.Float:
    """Direct light of wall points over the projector's; 0 if the camera does not see the wall there."""
    one, two = dr.gather(QUAD, lattice, 2 * index), dr.gather(QUAD, lattice, 2 * index + 1)
    return _direct(Wall(batch, scene), one, two)


def _direct(wall: Wall, one: mi.Vector4f, two: mi.Vector4f) -> mi.Float:
    """Direct light of the record of a wall point."""
    at = mi.Point3f(one.x, one.y, one.z)
    return wall.lobe(-at / one.w, -at / one.w, two.x, two.y) * one.w / (at.z**3)
