"""Light of the hidden surface that the wall reflects. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from render.transport.kernels.visibility import unoccluded


def wall_lobe(
    si: mi.SurfaceInteraction3f, bsdf: mi.BSDFPtr, there: mi.Point3f, active: mi.Bool
) -> tuple[mi.Float, mi.Vector3f, mi.Float]:
    """Radiance towards the camera per intensity of a light `there`, f cos a / d²; direction and distance."""
    gap = there - si.p
    squared = dr.squared_norm(gap)
    distance = dr.sqrt(squared)
    direction = gap / distance
    reflected = bsdf.eval(mi.BSDFContext(), si, si.to_local(direction), active).x
    return dr.select(active, reflected / squared, 0), direction, distance


def light_transport(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDFPtr,
    position: mi.Point3f,
    normal: mi.Point3f,
    light: mi.UInt32,
) -> tuple[mi.Float, mi.Float]:
    """Radiance towards the camera per intensity of a light, f cos a cos b / d² V, and its distance d."""
    there = dr.gather(mi.Point3f, position, light)
    facing = dr.gather(mi.Point3f, normal, light)
    active = si.is_valid() & (dr.dot(facing, there - si.p) < 0)
    lobe, direction, distance = wall_lobe(si, bsdf, there, active)
    seen = unoccluded(scene, si.p, si.n, there, facing, lobe > 0)
    return dr.select(seen, -lobe * dr.dot(facing, direction), 0), distance


@dr.syntax
def gather_phasors(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    position: mi.Point3f,
    normal: mi.Point3f,
    real: mi.Float,
    imaginary: mi.Float,
    phase_per_metre: list[mi.Float],
    first: mi.UInt32,
    last: mi.UInt32,
    step: mi.UInt32,
) -> tuple[list[mi.Float], list[mi.Float]]:
    """Real and imaginary parts of sum over lights of transport x intensity x exp(j k (d + t)), by frequency.

    Each lane sums every `step`-th light from `first` to before `last`. `real` and `imaginary` are the complex
    intensities of the lights, (lights, frequencies) in C order. A ray that met nothing gets zero.
    """
    frequency_count = len(phase_per_metre)
    total_re = [mi.Float(0) for _ in range(frequency_count)]
    total_im = [mi.Float(0) for _ in range(frequency_count)]
    bsdf = si.bsdf()
    travelled = dr.select(si.is_valid(), si.t, 0)
    light = mi.UInt32(first)
    while (light < last) & si.is_valid():
        transport, distance = light_transport(scene, si, bsdf, position, normal, light)
        opl = distance + travelled
        for index in range(frequency_count):
            sine, cosine = dr.sincos(phase_per_metre[index] * opl)
            re = dr.gather(mi.Float, real, light * frequency_count + index)
            im = dr.gather(mi.Float, imaginary, light * frequency_count + index)
            total_re[index] += transport * (re * cosine - im * sine)
            total_im[index] += transport * (re * sine + im * cosine)
        light += step
    return total_re, total_im


def carrier_path(si: mi.SurfaceInteraction3f, centre: mi.Point3f) -> tuple[mi.Float, mi.Float]:
    """Amplitude of the light of `carrier_phasors`, and its optical path length to the camera, metres."""
    lobe, _, distance = wall_lobe(si, si.bsdf(), centre, si.is_valid())
    return lobe, distance + dr.select(si.is_valid(), si.t, 0)


def carrier_phasors(
    si: mi.SurfaceInteraction3f, centre: mi.Point3f, phase_per_metre: list[mi.Float]
) -> tuple[list[mi.Float], list[mi.Float]]:
    """Phasors f cos a / d² exp(j k (d + t)) of a light of intensity 1 at `centre` that nothing occludes."""
    lobe, opl = carrier_path(si, centre)
    turned = [dr.sincos(k * opl) for k in phase_per_metre]
    return [lobe * cosine for _, cosine in turned], [lobe * sine for sine, _ in turned]
