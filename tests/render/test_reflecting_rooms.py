"""Rooms that reflect: their light by quadrature and the path tracer, their files, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from many_light_scenes import path_phasors
from numpy.linalg import norm

from disk import NightError
from itof import TransientLayout, phase_per_metre, pixel_rays, read_image
from render.rendering import Renderer
from render.settings import RenderError, settings_for
from render.transport.scene_loading import load_scene
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    camera_axes,
    preset_from_dict,
    sample_scene,
    wall_normal,
)
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
    # Wall, floor or middle wall, wall: both integrals by Gauss nodes. Those of the lit wall that the middle
    # wall hides do not count. Its edge crosses one of eight columns of pixels, of five columns of nodes
    # each. Half a column too much or too little is 1 / 80 of the light.
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
    assert (off < 1 / 80 + float(image.attributes["room_error"])).all()


def free(scene, points, others):
    """(N, M) whether the middle wall leaves points (N, 3) and others (M, 3) in sight of each other."""
    starts = np.repeat(points, len(others), axis=0)
    return ~crosses(scene.middle_wall, starts, np.tile(others, (len(points), 1))).reshape(len(points), -1)


def test_the_light_of_the_object_stays_what_it_is_in_a_black_room(corner, rendered, make_dataset):
    black = make_dataset(CORNER)
    settings = settings_for(black, {"device": "cpu", "product": "itof", "error": 0.01})
    list(Renderer(black, settings).render_all(black.ids()))
    for scene_id, image in rendered.items():
        before = read_image(black.render_folder(scene_id) / MEASUREMENT_FILE)
        same = {name for name in before.channels if not name.startswith("itof")}
        assert {name for name in image.channels if name.startswith(("direct", "hidden"))} == same
        assert all(np.array_equal(image.channels[name], before.channels[name]) for name in same)
        total = sum(image.phasors(part)[0] for part in ("direct", "hidden", "room"))
        assert np.allclose(image.phasors()[0], total, rtol=1e-6)
        truths = (read_image(each.render_folder(scene_id) / GROUND_TRUTH_FILE) for each in (corner, black))
        one, other = (truth.channels for truth in truths)
        assert all(np.array_equal(one[name], other[name]) for name in other)


def test_a_black_room_is_none():
    black = sample_scene(preset_from_dict({"room": {"floor": 0.0}}, "test"), 0)
    assert black == sample_scene(preset_from_dict({}, "test"), 0)
    assert not black.room_reflects
    lit = sample_scene(preset_from_dict({"room": {"floor": 0.5, "middle_wall": 0.2}}, "test"), 0)
    assert [wall.name for wall in lit.room] == ["floor"]
    assert lit.in_black_room() == black


def test_a_floor_meets_the_lowest_side_of_a_relay_wall_that_is_turned():
    turned = {"rotation_deg": [0.0, 90.0, 20.0], "location_m": [0.3, 0.1, 1.5], "size_m": [3.0, 6.0]}
    preset = preset_from_dict({"relay_wall": turned, "room": {"floor": 0.5, "ceiling": 0.5}}, "test")
    relay, (floor, ceiling) = sample_scene(preset, 0).relay_wall, sample_scene(preset, 0).room
    for wall, height_m in ((floor, 0.0), (ceiling, 3.0)):
        corners = corners_of(wall)
        assert np.allclose(corners[:, 2], height_m)
        edge = corners_of(relay)[np.isclose(corners_of(relay)[:, 2], height_m)]
        assert all(np.isclose(norm(corners - end, axis=1).min(), 0, atol=1e-6) for end in edge)
    assert np.allclose(wall_normal(floor), [0, 0, 1])
    assert np.allclose(wall_normal(ceiling), [0, 0, -1])


def test_what_a_room_makes_impossible_is_refused(corner):
    below = {"camera": {"location_m": [1.0, -1.0, -0.2]}, "room": {"floor": 0.5}}
    with pytest.raises(NightError, match=r"the camera at .* is behind the floor of the room"):
        refuse_impossible_corner(preset_from_dict(below, "test"))
    scene = next(each for each in map(corner.scene, corner.ids()) if each.hidden_objects)
    (cube,) = scene.hidden_objects
    sunk = replace(scene, hidden_objects=(replace(cube, location_m=(1.15, 0.9, 0.1)),))
    assert refusal(scene) is None
    assert refusal(sunk) == "cube (hidden_object_0) reaches through the floor"
    for given in ({"product": "both"}, {"product": "itof", "max_bounces": 4}):
        settings = settings_for(corner, {"device": "cpu", "method": "many-light"} | given)
        with pytest.raises(RenderError, match=r"its room reflects .* only --method path renders"):
            Renderer(corner, settings).render(scene.id)


@pytest.mark.long
def test_a_room_in_view_has_the_light_of_the_path_tracer(make_dataset, variant):
    # The camera sees the edge of the middle wall: light of one, two and three bounces on both walls.
    camera = {"width": 16, "height": 12, "rotation_deg": [90.0, 0.0, 38.0]}
    dataset = make_dataset(
        CORNER | {"dataset": {"count": 1, "seed": 5}, "camera": camera, "room": {"middle_wall": 0.5}}
    )
    (scene_id,) = dataset.ids()
    Renderer(dataset, settings_for(dataset, {"device": "cpu", "product": "itof"})).render(scene_id)
    image = read_image(dataset.render_folder(scene_id) / MEASUREMENT_FILE)
    total, hidden = (image.phasors(part)[0].astype(complex) for part in ("itof", "hidden"))
    layout = TransientLayout(16, 12, 2000, 0.01, 0.0)
    runs = path_phasors(load_scene(dataset, scene_id), variant, seeds=range(12), spp=2048, layout=layout)
    assert (norm(image.phasors("room")[0], axis=(0, 1)) > 50 * norm(hidden, axis=(0, 1))).all()
    variance = (runs.real.var(axis=0, ddof=1) + runs.imag.var(axis=0, ddof=1)) / len(runs)
    squared = np.abs(runs.mean(axis=0) - total) ** 2
    chi = squared.sum(axis=(0, 1)) / variance.sum(axis=(0, 1))
    scatter = np.sqrt((2 + 2 / 11) * (variance**2).sum(axis=(0, 1))) / variance.sum(axis=(0, 1))
    own = (float(image.attributes["room_error"]) * norm(hidden, axis=(0, 1))) ** 2
    assert (np.abs(chi - 1) < 4 * scatter + own / variance.sum(axis=(0, 1))).all()
