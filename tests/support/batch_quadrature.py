"""The light of one cube in a corner with a diffuse wall, and nodes of the parts of pixels that show the wall.

Independent of the engines: other axes, even film cells, a segment test for what walls hide, and polygons that
are clipped edge by edge.
"""

import numpy as np

from itof import phase_per_metre
from scenegen.making.outlines import clipped, wall_corners
from scenegen.pose import camera_axes, rotation_matrix

_ROUNDED = 1e-9  # of a film, and metres


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


class Pinhole:
    """A camera or a projector: its place, its axes right, down and forward, and half its film z = 1."""

    def __init__(self, place, aspect):
        self.place, self.axes = np.array(place.location_m), camera_axes(place)
        wide = np.tan(np.radians(place.horizontal_fov_deg) / 2)
        self.half = np.array([wide, wide / aspect])

    def centres(self, width, height):
        """(H, W) x and y of the middles of even cells of the film."""
        x, y = ((np.arange(count) + 0.5) / count * 2 - 1 for count in (width, height))
        return np.meshgrid(x * self.half[0], y * self.half[1])

    def film(self, points):
        """Film x and y of points."""
        local = (points - self.place) @ self.axes.T
        return local[..., 0] / local[..., 2], local[..., 1] / local[..., 2]

    def dots(self, emitter):
        """(2, N, 2) first and last x and y of the dots of a projector, the whole film if it has none."""
        columns, rows = emitter.dots or (1, 1)
        middles = np.stack(self.centres(columns, rows), axis=-1).reshape(-1, 2)
        reach = self.half / (columns, rows) / emitter.spacing
        return np.stack([middles - reach, middles + reach])


class CubeLight:
    """The direct and hidden radiance of a scene with one cube, W m^-2 sr^-1.

    Parameters
    ----------
    cells : a third of the film cells along each column.
    nodes : along each side of a face of the cube.
    surface : points (S, 3), normals (S, 3) and areas (S,) of another hidden surface; its normals leave it.
    shadow : function of wall points (M, 3); (M, S) whether that surface hides its points from them.
    """

    def __init__(self, scene, frequencies_hz, cells, nodes=0, surface=None, shadow=None):
        self.scene, self.turns = scene, phase_per_metre(frequencies_hz)
        self.relay, self.middle = Sides(scene.relay_wall), Sides(scene.middle_wall)
        aspect = scene.camera.width / scene.camera.height
        columns, rows = scene.emitter.dots or (scene.camera.width, scene.camera.height)
        self.eye, self.projector = Pinhole(scene.camera, aspect), Pinhole(scene.emitter, columns / rows)
        self.camera = self.eye.place
        self.points, self.normals, self.areas = surface or _cube(scene.hidden_objects[0], nodes)
        self.shadow = shadow
        x, y, area = self.lit_film(cells)
        at, seen, _ = self.on_wall(x, y, self.projector)
        flux, lit = np.pi * area * seen, seen  # of each film cell, at 1 W/m²
        at, flux = at[lit], flux[lit]
        radiosity = self.reflectance(at) / np.pi * flux  # per cosine and square metre
        reach = np.linalg.norm(at - self.projector.place, axis=-1)
        self.irradiance = np.zeros((len(self.turns), len(self.points)), complex)
        for rows in self._parts(at):
            transfer, way = self._exchanged(at[rows])
            for place, k in enumerate(self.turns):
                sent = radiosity[rows] * np.exp(1j * k * reach[rows])
                self.irradiance[place] += sent @ (transfer * np.exp(1j * k * way))

    def centres(self, width, height):
        """(H, W) x and y of the middles of even cells of the camera's film."""
        return self.eye.centres(width, height)

    def lit_film(self, cells):
        """x, y and areas of even cells, as many in each dot as on a film without dots."""
        x, y = (
            np.stack(np.meshgrid(*[np.arange(n * cells) + 0.5 for n in (4, 3)]))
            / np.array([4, 3])[:, None, None]
            / cells
        )
        first, last = self.projector.dots(self.scene.emitter)
        x, y = (
            first[:, axis, None] + each.ravel() * (last - first)[:, axis, None]
            for axis, each in enumerate((x, y))
        )
        return x.ravel(), y.ravel(), np.prod(last[0] - first[0]) / (12 * cells**2)

    def on_wall(self, x, y, pinhole=None):
        """Places where film points see the relay wall, whether they do, and the cosine there."""
        pinhole = pinhole or self.eye
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ pinhole.axes
        away = 100 * rays
        share, meets = self.relay.crossing(pinhole.place + 0 * away, pinhole.place + away)
        at = pinhole.place + share[..., None] * away
        nearer, hidden = self.middle.crossing(pinhole.place + 0 * away, at)
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
        at, seen, _ = self.on_wall(x, y)
        x, y = self.projector.film(at)
        first, last = self.projector.dots(self.scene.emitter)
        film = np.stack([x, y], axis=-1)[..., None, :]
        lit = ((film >= first - _ROUNDED) & (film <= last + _ROUNDED)).all(-1).any(-1)
        _, free, cosine = self.on_wall(x, y, self.projector)
        intensity = np.pi * np.sqrt(1 + x**2 + y**2) ** 3  # of the projector: π / cos³
        squared = ((at - self.projector.place) ** 2).sum(-1)
        return np.where(seen & lit & free, self.reflectance(at) / np.pi * cosine * intensity / squared, 0)

    def lengths(self, x, y):
        """Lengths of the ways from the projector over the wall to film points."""
        at, _, _ = self.on_wall(x, y)
        return sum(np.linalg.norm(at - place, axis=-1) for place in (self.projector.place, self.camera))

    def direct_image(self, width, height, cells):
        """(H, W, F) direct phasors: each cell of the projector's film, in the pixel that sees its middle."""
        x, y, area = self.lit_film(cells)
        at, lit, _ = self.on_wall(x, y, self.projector)
        x, y = self.eye.film(at)
        again, seen, cosine = self.on_wall(x, y)
        lit &= seen & (np.linalg.norm(again - at, axis=-1) < _ROUNDED)
        squared = ((at - self.camera) ** 2).sum(-1)
        energy = self.reflectance(at) * area * cosine * np.sqrt(1 + x**2 + y**2) ** 3 / squared
        columns, rows = (
            np.floor((f / h + 1) / 2 * n)
            for f, h, n in zip((x, y), self.eye.half, (width, height), strict=True)
        )
        kept = lit & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        pixel = (rows * width + columns)[kept].astype(int)
        image = np.zeros((width * height, len(self.turns)), complex)
        turned = np.exp(1j * self.turns * self.lengths(x, y)[kept, None])
        np.add.at(image, pixel, energy[kept, None] * turned)
        return image.reshape(height, width, -1) * width * height / (4 * self.eye.half.prod())

    def over_direct(self, width, height):
        """(H, W, F) hidden over direct phasors at pixel centres; NaN where the wall is not seen."""
        x, y = self.centres(width, height)
        _, seen, _ = self.on_wall(x, y)
        back = np.exp(-1j * self.turns * self.lengths(x, y)[..., None])
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.hidden(x, y) * back / np.where(seen, self.direct(x, y), np.nan)[..., None]

    def hidden(self, x, y):
        """(H, W, F) phasors of the hidden light at film points; 0 where the wall is not seen."""
        all_at, seen, _ = self.on_wall(x, y)
        at = all_at[seen]
        found = np.empty((len(at), len(self.turns)), complex)
        sent = self.areas * self.scene.hidden_objects[0].reflectance / np.pi * self.irradiance
        for rows in self._parts(at):
            transfer, way = self._exchanged(at[rows])
            for place, k in enumerate(self.turns):
                found[rows, place] = (transfer * np.exp(1j * k * way)) @ sent[place]
        reach = np.linalg.norm(at - self.camera, axis=-1)[:, None]
        image = np.zeros((*seen.shape, len(self.turns)), complex)
        image[seen] = found * np.exp(1j * self.turns * reach) * (self.reflectance(at) / np.pi)[:, None]
        return image

    def _parts(self, at):
        """Slices of wall points, each of which has a million pairs with the surface at most."""
        step = max(1, 10**6 // len(self.points))
        return [slice(first, first + step) for first in range(0, len(at), step)]

    def _exchanged(self, at):
        """(M, S) cos cos / d² between wall points and points of the cube, 0 in shadow, and d."""
        gap = self.points - at[:, None]
        way = np.linalg.norm(gap, axis=-1)
        at_wall = np.abs(gap @ self.relay.normal) / way
        at_cube = np.maximum(-(gap * self.normals).sum(-1) / way, 0)
        start = np.broadcast_to(at[:, None], gap.shape)
        _, hidden = self.middle.crossing(start, start + gap)
        if self.shadow is not None:
            hidden |= self.shadow(at)
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
