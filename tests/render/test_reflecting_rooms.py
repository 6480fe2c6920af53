"""Rooms that reflect: their light against quadrature and the path tracer, their files, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from many_light_scenes import path_phasors
from numpy.linalg import norm

from itof import TransientLayout, phase_per_metre, pixel_rays, read_image
from render.rendering import Renderer
from render.settings import RenderError, settings_for
from render.transport.scene_loading import load_scene
from scenegen import MEASUREMENT_FILE, camera_axes, preset_from_dict, sample_scene, scene_to_json
from scenegen.corner_check import refuse_impossible_corner
from scenegen.corner_geometry import corners_of, crosses
from scenegen.geometry_check import refusal

WIDTH, HEIGHT = 8, 6
CORNER = {
    "dataset": {"count": 2, "seed": 5},
    "hidden_object": {
        "shapes": ["cube"],
        "location_m": {"x": 1.15, "y": 0.9, "z": 1.6},
        "empty_fraction": 0.5,
    },
    "relay_wall": {"material": "diffuse"},
    "camera": {"width": WIDTH, "height": HEIGHT},
}
ALBEDO = {"middle_wall": 0.5, "floor": 0.3}
GAUSS = 12


@pytest.fixture(scope="module")
def corner(make_dataset):
    """An empty corner and a cube behind it, in a room with a floor and a middle wall."""
    return make_dataset(CORNER | {"room": ALBEDO})


@pytest.fixture(scope="module")
def rendered(corner):
    """Their images by id."""
    settings = settings_for(corner, {"device": "cpu", "product": "itof", "error": 0.01})
    made = Renderer(corner, settings).render_all(corner.ids())
    assert not [each for each in made if isinstance(each, Exception)]
    return {each: read_image(corner.render_folder(each) / MEASUREMENT_FILE) for each in corner.ids()}


def empty_id(corner):
    return next(each for each in corner.ids() if not corner.scene(each).hidden_objects)


def rectangle(centre, x, y, size_m, counts):
    """(N, 3) Gauss nodes and (N,) areas of a rectangle, cut into stretches of 0.5 m."""
    axes = []
    for side, count in zip(size_m, counts, strict=True):
        node, weight = np.polynomial.legendre.leggauss(GAUSS // 2)
        step = side / count
        starts = -side / 2 + step * np.arange(count)
        axes.append(((starts[:, None] + step * (node + 1) / 2).ravel(), np.tile(weight * step / 2, count)))
    (a, da), (b, db) = axes
    points = centre + a[:, None, None] * x + b[None, :, None] * y
    return points.reshape(-1, 3), np.outer(da, db).ravel()


def lit_wall(scene, pixels):
    """Places, irradiance times area, and paths from the projector, of nodes of the lit relay wall x = 0."""
    rays, weights = film_nodes(scene, pixels)
    rays = rays.reshape(-1, 3)
    depth = scene.camera.location_m[0] / -rays[:, 0]
    points = scene.camera.location_m + depth[:, None] * rays
    free = ~crosses(scene.middle_wall, np.array(scene.camera.location_m), points)
    half = np.tan(np.radians(scene.camera.horizontal_fov_deg) / 2)
    film = (2 * half) ** 2 * HEIGHT / WIDTH  # area of the image at depth 1
    flux = np.pi * film * np.tile(weights, WIDTH * HEIGHT) / (WIDTH * HEIGHT)
    return points, flux * free, depth * norm(rays, axis=1)


def film_nodes(scene, order):
    """(H, W, n, 3) rays of depth 1 through Gauss nodes of the pixels, and the weights (n,) of the nodes."""
    node, weight = np.polynomial.legendre.leggauss(order)
    centres = pixel_rays(WIDTH, HEIGHT, scene.camera.horizontal_fov_deg)
    centres = centres / centres[..., 2:]
    pitch = 2 * np.tan(np.radians(scene.camera.horizontal_fov_deg) / 2) / WIDTH
    x, y = (each.ravel() for each in np.meshgrid(node, node))
    offsets = np.stack([x, y, np.zeros_like(x)], axis=-1) * pitch / 2
    return (centres[:, :, None] + offsets) @ camera_axes(scene.camera), np.outer(weight, weight).ravel() / 4


def transfer(points, others, normal, other_normal):
    """(N, M) cos cos / d² between surfaces, and d, from points (N, 3) to others (M, 3)."""
    gap = others[None] - points[:, None]
    distance = norm(gap, axis=-1)
    towards = gap / distance[..., None]
    return np.clip(towards @ normal, 0, None) * np.clip(
        -towards @ other_normal, 0, None
    ) / distance**2, distance


def test_the_light_of_an_empty_room_is_a_sum_over_its_patches(corner, rendered):
    # Wall, floor or middle wall, wall: both integrals by Gauss nodes. The camera sees the wall alone. Nodes of
    # the lit wall beside the middle wall's edge count or not: of 48 x 5² nodes, an edge crosses less than a
    # tenth, and half of each is wrong at most in alternating sense: less than 1 % of the light.
    scene_id = empty_id(corner)
    scene, image = corner.scene(scene_id), rendered[scene_id]
    room, hz = image.phasors("room")
    lit, flux, before_m = lit_wall(scene, 5)
    rays, weights = film_nodes(scene, 2)
    depth = scene.camera.location_m[0] / -rays[..., 0]
    seen = scene.camera.location_m + depth[..., None] * rays  # (H, W, n, 3)
    after_m = depth * norm(rays, axis=-1)
    shown = ~crosses(scene.middle_wall, np.array(scene.camera.location_m), seen.reshape(-1, 3))
    whole = shown.reshape(HEIGHT, WIDTH, -1).all(axis=-1)
    expected = np.zeros((HEIGHT, WIDTH, len(hz)), complex)
    wall = np.array([1.0, 0.0, 0.0])
    floor = rectangle(np.array([2.0, 0, 0]), wall, np.array([0.0, 1, 0]), (4, 8), (8, 16))
    middle = rectangle(np.array([2.35, 0, 2.0]), wall, np.array([0.0, 0, 1]), (3.3, 4), (7, 8))
    surfaces = [(floor, [np.array([0.0, 0, 1])], 0.3)]
    surfaces.append((middle, [np.array([0.0, 1, 0]), np.array([0.0, -1, 0])], 0.5))
    targets = seen.reshape(-1, 3)
    for (points, areas), normals, albedo in surfaces:
        for normal in normals:
            to_lit, lit_m = transfer(points, lit, normal, wall)
            to_seen, seen_m = transfer(points, targets, normal, wall)
            if len(normals) == 1:  # the middle wall shades the floor, not itself
                to_lit *= free(scene, points, lit)
                to_seen *= free(scene, points, targets)
            for number, turn in enumerate(phase_per_metre(hz)):
                arrived = (to_lit * np.exp(1j * turn * lit_m)) @ (flux * np.exp(1j * turn * before_m)) / np.pi
                sent = arrived * areas * albedo / np.pi
                z = (sent @ (to_seen * np.exp(1j * turn * seen_m))) / np.pi
                z = z.reshape(after_m.shape) * np.exp(1j * turn * after_m)
                expected[..., number] += z @ weights
    off = norm(room[whole] - expected[whole], axis=0) / norm(expected[whole], axis=0)
    assert whole.sum() > 20
    assert (off < 0.01 + float(image.attributes["room_error"])).all(), off


def free(scene, points, others):
    """(N, M) whether the middle wall leaves points (N, 3) and others (M, 3) in sight of each other."""
    starts = np.repeat(points, len(others), axis=0)
    return ~crosses(scene.middle_wall, starts, np.tile(others, (len(points), 1))).reshape(len(points), -1)
