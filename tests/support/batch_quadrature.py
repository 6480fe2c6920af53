"""The light of one cube in a corner with a diffuse wall, and nodes of the parts of pixels that show the wall.

Independent of the engines: other axes, even film cells, a segment test for what walls hide, and polygons that
are clipped edge by edge.
"""

import numpy as np

from itof import phase_per_metre
from scenegen.making.outlines import clipped, wall_corners
from scenegen.pose import camera_axes, rotation_matrix


class Sides:
    """A rectangle: its middle, normal, unit sides and half extents."""

    def __init__(self, wall):
        self.middle = np.array(wall.location_m)
        self.right, self.up, self.normal = rotation_matrix(wall.rotation_deg).T
        self.half = np.array(wall.size_m) / 2

    def places(self, points):
        """(..., 2) along the sides, over the half extents."""
        gap = points - self.middle
        return np.stack([gap @ self.right, gap @ self.up], axis=-1) / self.half

    def crossing(self, start, end):
        """Share of the way at which segments meet the plane, and whether they meet the rectangle."""
        before, behind = (start - self.middle) @ self.normal, (end - self.middle) @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            share = before / (before - behind)
            where = start + share[..., None] * (end - start)
            return share, (before * behind < 0) & (np.abs(self.places(where)) <= 1).all(-1)


class CubeLight:
    """The direct and hidden radiance of a scene with one cube, W m^-2 sr^-1."""

    def __init__(self, scene, frequencies_hz, cells, nodes):
        self.scene, self.turns = scene, phase_per_metre(frequencies_hz)
        self.relay, self.middle = Sides(scene.relay_wall), Sides(scene.middle_wall)
        self.camera, self.axes = np.array(scene.camera.location_m), camera_axes(scene.camera)
        self.points, self.normals, self.areas = _cube(scene.hidden_objects[0], nodes)
        x, y = self.centres(4 * cells, 3 * cells)
        at, seen, _ = self.on_wall(x, y)
        flux = np.pi * (x[0, 1] - x[0, 0]) * (y[1, 0] - y[0, 0]) * seen  # of each film cell, at 1 W/m²
        lit = flux > 0
        transfer, way = self._exchanged(at[lit])
        radiosity = self.reflectance(at[lit]) / np.pi * flux[lit]  # per cosine and square metre
        travelled = np.linalg.norm(at[lit] - self.camera, axis=-1)[:, None] + way
        self.irradiance = [
            (radiosity[:, None] * transfer * np.exp(1j * k * travelled)).sum(0) for k in self.turns
        ]

    def centres(self, width, height):
        """(H, W) x and y of the middles of even cells of the film z = 1."""
        half = np.tan(np.radians(self.scene.camera.horizontal_fov_deg) / 2)
        aspect = self.scene.camera.width / self.scene.camera.height
        x, y = ((np.arange(count) + 0.5) / count * 2 - 1 for count in (width, height))
        return np.meshgrid(x * half, y * half / aspect)

    def on_wall(self, x, y):
        """Places where film points see the relay wall, whether they do, and the cosine there."""
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ self.axes
        away = 100 * rays
        share, meets = self.relay.crossing(self.camera + 0 * away, self.camera + away)
        at = self.camera + share[..., None] * away
        nearer, hidden = self.middle.crossing(self.camera + 0 * away, at)
        cosine = np.abs(rays @ self.relay.normal) / np.linalg.norm(rays, axis=-1)
        return at, meets & ~(hidden & (nearer < 1)), cosine

    def reflectance(self, at):
        """Of the relay wall at points of it (`scenegen.scene.Darkening`)."""
        wall = self.scene.relay_wall
        if wall.darkening is None:
            return np.full(at.shape[:-1], wall.reflectance)
        angle = np.radians(wall.darkening.direction_deg)
        step = np.array([np.cos(angle), np.sin(angle)]) * wall.size_m
        along = (1 + self.relay.places(at) @ step / np.abs(step).sum()) / 2
        return wall.reflectance + along * (wall.darkening.least_reflectance - wall.reflectance)

    def direct(self, x, y):
        """Radiance of the direct return at film points, without its phase; 0 where the wall is not seen."""
        at, seen, cosine = self.on_wall(x, y)
        intensity = np.pi * np.sqrt(1 + x**2 + y**2) ** 3  # of the projector: π / cos³
        squared = ((at - self.camera) ** 2).sum(-1)
        return np.where(seen, self.reflectance(at) / np.pi * cosine * intensity / squared, 0)

    def over_direct(self, width, height):
        """(H, W, F) hidden over direct phasors at pixel centres; NaN where the wall is not seen."""
        x, y = self.centres(width, height)
        at, seen, _ = self.on_wall(x, y)
        transfer, way = self._exchanged(at[seen])
        sent = [self.areas * self.scene.hidden_objects[0].reflectance / np.pi * e for e in self.irradiance]
        reach = np.linalg.norm(at[seen] - self.camera, axis=-1)[:, None]
        found = np.full((height, width, len(self.turns)), np.nan, complex)
        for place, (k, power) in enumerate(zip(self.turns, sent, strict=True)):
            radiance = (transfer * power * np.exp(1j * k * (way - reach))).sum(1)
            found[seen, place] = self.reflectance(at[seen]) / np.pi * radiance / self.direct(x, y)[seen]
        return found

    def _exchanged(self, at):
        """(M, S) cos cos / d² between wall points and points of the cube, 0 in shadow, and d."""
        gap = self.points - at[:, None]
        way = np.linalg.norm(gap, axis=-1)
        at_wall = np.abs(gap @ self.relay.normal) / way
        at_cube = np.maximum(-(gap * self.normals).sum(-1) / way, 0)
        start = np.broadcast_to(at[:, None], gap.shape)
        _, hidden = self.middle.crossing(start, start + gap)
        return np.where(hidden, 0, at_wall * at_cube / way**2), way


def _cube(part, count):
    """Gauss nodes (S, 3) on the faces of a placed cube, normals (S, 3) and areas (S,)."""
    node, weight = np.polynomial.legendre.leggauss(count)
    u, v = (each.ravel() for each in np.meshgrid(node / 2, node / 2))
    size, turned = np.array(part.size_m), rotation_matrix(part.rotation_deg)
    points, normals, areas = [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            face, normal = np.zeros((len(u), 3)), np.zeros(3)
            face[:, axis - 2], face[:, axis - 1], face[:, axis], normal[axis] = u, v, side / 2, side
            points.append(face * size @ turned.T + part.location_m)
            normals.append(np.broadcast_to(turned @ normal, face.shape))
            areas.append(np.outer(weight, weight).ravel() / 4 * size[axis - 2] * size[axis - 1])
    return np.concatenate(points), np.concatenate(normals), np.concatenate(areas)


def free_nodes(scene, width, height, whole, cut, pixels=None):
    """Gauss nodes of the parts of pixels that show the relay wall: polygons, divided into triangles.

    Parameters
    ----------
    whole, cut : nodes along each side, of whole pixels and of triangles of pixels with an edge.
    pixels : row-major indices; None is all.

    Returns
    -------
    (N, 2) film positions, x and y from 0 to 1; (N,) shares of the pixel; (N,) pixel; pixels with an edge.
    """
    half = np.array([1.0, height / width]) * np.tan(np.radians(scene.camera.horizontal_fov_deg) / 2)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    found, edges = [], []
    for pixel in range(width * height) if pixels is None else pixels:
        at = (np.array([pixel % width, pixel // width]) + square) / (width, height)
        parts = _free_parts(scene, np.column_stack([(2 * at - 1) * half, np.ones(4)]))
        parts = [(part[:, :2] / half + 1) / 2 * (width, height) for part in parts]  # in pixels
        shares = [(part, *_triangle_nodes(part, cut)) for part in parts]
        area = sum(weights.sum() for *_, weights in shares)
        if area > 1 - 1e-9:
            node, weight = np.polynomial.legendre.leggauss(whole)
            x, y = (each.ravel() for each in np.meshgrid((node + 1) / 2, (node + 1) / 2))
            nodes = np.column_stack([x + pixel % width, y + pixel // width])
            shares = [(None, nodes, np.outer(weight, weight).ravel() / 4)]
        elif area > 1e-9:
            edges.append(pixel)
        else:
            continue
        found += [(nodes / (width, height), weights, 0 * weights + pixel) for _, nodes, weights in shares]
    points, weights, pixel = (np.concatenate(each) for each in zip(*found, strict=True))
    return points, weights, pixel.astype(int), np.array(edges, int)


def _free_parts(scene, polygon):
    """The convex parts of a polygon on the film z = 1 that show the relay wall."""
    axes, eye = camera_axes(scene.camera), np.array(scene.camera.location_m)
    (relay, plane), (middle, nearer) = (
        _cone((wall_corners(wall) - eye) @ axes.T) for wall in (scene.relay_wall, scene.middle_wall)
    )
    here = np.zeros(3)
    polygon = clipped(polygon, [(here, plane), *((here, side) for side in relay)])
    parts = []
    for side in (nearer, *middle, nearer - plane):  # inside of all, the middle wall is seen
        if len(polygon) < 3:
            break
        parts.append(clipped(polygon, [(here, -side)]))
        polygon = clipped(polygon, [(here, side)])
    return [part for part in parts if len(part) > 2]


def _cone(corners):
    """Inward normals of the planes through the origin and a rectangle's edges; its plane m, m · p = 1."""
    sides = np.cross(corners, np.roll(corners, -1, axis=0))
    across = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return sides * np.sign(sides @ corners.mean(0))[:, None], across / (across @ corners[0])


def _triangle_nodes(polygon, order):
    """Gauss nodes and areas over the triangles of a convex polygon (M, 2), denser at its first corner."""
    node, weight = np.polynomial.legendre.leggauss(order)
    u, v = np.meshgrid((node + 1) / 2, (node + 1) / 2, indexing="ij")
    points, areas = [np.zeros((0, 2))], [np.zeros(0)]
    for one, two in zip(polygon[1:-1] - polygon[0], polygon[2:] - polygon[0], strict=True):
        points.append((polygon[0] + u[..., None] * (one + v[..., None] * (two - one))).reshape(-1, 2))
        areas.append((np.outer(weight, weight) / 4 * u).ravel() * abs(one[0] * two[1] - one[1] * two[0]))
    return np.concatenate(points), np.concatenate(areas)
