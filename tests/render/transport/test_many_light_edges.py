"""Many-light at its edges: rays that miss everything, thin shells, sharp edges, light without end."""

import numpy as np
import pytest
import trimesh
from many_light_scenes import (
    CAMERA_LOCATION_M,
    FREQUENCIES_HZ,
    HORIZONTAL_FOV_DEG,
    OBJECT_LOCATION_M,
    PROJECTOR_FOV_DEG,
    SMALL,
    Corner,
    ball,
    box,
    expose,
    measure,
    relative,
    rough_plastic,
)
from odd_corners import OddCorner
from small_patch import AXES
from three_bounce_quadrature import hidden_phasors

from itof import TransientLayout, pixel_rays
from render.transport.lights.hidden_surface import HiddenSurfaceError

# Rays that miss

WIDE_DEG = 2 * np.degrees(np.arctan(2 * np.tan(np.radians(HORIZONTAL_FOV_DEG) / 2)))  # twice the image plane


def layout_of(width, height):
    return TransientLayout(width, height, 2500, 0.01, 0.0)


def misses(width, height, fov_deg, wall_half_m):
    """(H, W) pixels of which no corner sees the relay wall."""
    rays = pixel_rays(width, height, fov_deg)
    rays = rays / rays[..., 2:]
    half_pixel = np.tan(np.radians(fov_deg) / 2) / width
    missed = np.ones((height, width), bool)
    for x in (-half_pixel, half_pixel):
        for y in (-half_pixel, half_pixel):
            at = (rays + np.array([x, y, 0])) @ AXES
            t = CAMERA_LOCATION_M[0] / np.where(at[..., 0] < 0, -at[..., 0], np.nan)
            off = np.abs(t[..., None] * at + CAMERA_LOCATION_M)[..., 1:] - [0, CAMERA_LOCATION_M[2]]
            missed &= ~(np.abs(off) < wall_half_m).all(axis=-1)
    return missed


@pytest.mark.parametrize(
    ("fov_deg", "size", "wall_half_m"),
    [
        pytest.param(60, (48, 64), 1.2, marks=pytest.mark.long),  # a portrait: it sees over the wall
        (60, (24, 18), 1),
    ],
)
def test_a_ray_that_meets_no_wall_returns_zero(variant, tmp_path, fov_deg, size, wall_half_m):
    corner = OddCorner((ball(),), fov_deg=fov_deg, size=size, wall_half_m=wall_half_m, has_middle_wall=False)
    exposure = expose(corner.load(tmp_path), variant, lights=64, layout=layout_of(*size))
    image = exposure.phasors()
    assert exposure.direct_image.lit is None  # a flash lights all that the camera sees
    transient = np.concatenate(list(exposure.row_blocks()))
    assert np.isfinite(image.error)
    assert np.isfinite(transient).all()
    for part in (image.total, image.direct, image.hidden):
        assert np.isfinite(part).all()
    missed = misses(*size, fov_deg, wall_half_m)
    assert missed.sum() > 10
    assert not image.total[missed].any()
    assert not transient[missed].any()
    seen = np.abs(image.total[..., 0]) > 0
    assert seen.sum() > 0.5 * seen.size


def test_a_wall_whose_edge_is_in_every_pixel_returns_what_finer_pixels_return(variant, tmp_path):
    corner = OddCorner((ball(),), fov_deg=76, size=(8, 6), wall_half_m=0.3, has_middle_wall=False)
    sizes = (8, 6), (64, 48)
    coarse, fine = (
        measure(corner.but(size=size).load(tmp_path), variant, lights=256, layout=layout_of(*size))
        for size in sizes
    )
    for part in ("direct", "hidden"):
        off = getattr(coarse, part) - getattr(fine, part).reshape(6, 8, 8, 8, -1).mean(axis=(1, 3))
        allowed = coarse.error * np.linalg.norm(coarse.hidden) + fine.error * np.linalg.norm(fine.hidden) / 8
        assert np.linalg.norm(off) < allowed


def test_rays_that_miss_leave_the_other_pixels_as_they_are(variant, tmp_path):
    # Twice the image plane with pixels of the same size: the middle of the image is the narrow image. The
    # projector of the narrow camera lights both. Rays on the right miss the wall.
    narrow = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    projector = narrow._emitter()
    wide = OddCorner(
        (ball(),),
        wall_bsdf=rough_plastic(0.5),
        fov_deg=WIDE_DEG,
        size=(48, 36),
        wall_half_m=4.0,
        other_emitter=projector,
    )
    one, all_ = (
        measure(scene.load(tmp_path), variant, lights=256, layout=layout_of(*size))
        for scene, size in (
            (OddCorner((ball(),), wall_bsdf=rough_plastic(0.5), wall_half_m=4.0), (24, 18)),
            (wide, (48, 36)),
        )
    )
    assert (np.abs(all_.total[..., 0]) == 0).any()
    middle = np.s_[9:27, 12:36]
    np.testing.assert_allclose(all_.direct[middle], one.direct, rtol=2e-5)  # float32 rays
    # The lights are the same; each image has at most a quarter of its random error by interpolation.
    assert np.all(relative(all_.hidden[middle], one.hidden) < 0.25 * (one.error + 2 * all_.error))


@pytest.mark.parametrize("options", [{"lights": 64}, {"lights": None}])
@pytest.mark.parametrize("scale", [np.inf, np.nan])
def test_an_emitter_without_a_finite_flux_is_refused(variant, tmp_path, scale, options):
    from disk import NightError

    scene = Corner((ball(),), emitter_scale=scale).load(tmp_path)
    with pytest.raises(NightError, match="emitters"):
        expose(scene, variant, layout=SMALL, **options)


# Thin shells

SIDE_M = 0.4
NORMAL = np.array([-1, 0.1, 0.2]) / np.linalg.norm([-1, 0.1, 0.2])
ACROSS = np.cross([0, 0, 1], NORMAL) / np.linalg.norm(np.cross([0, 0, 1], NORMAL))
FRAME = np.stack([NORMAL, ACROSS, np.cross(NORMAL, ACROSS)])


def plate(thickness_m):
    """A closed parallelepiped that shows a square to the wall."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = FRAME.T, OBJECT_LOCATION_M
    return trimesh.creation.box(extents=(thickness_m, SIDE_M, SIDE_M)).apply_transform(pose)


def plate_phasors(thickness_m):
    """(H, W, F) hidden phasors of that plate by quadrature over its six faces; it is convex."""
    half = np.array([thickness_m, SIDE_M, SIDE_M]) / 2
    z = 0
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for side in (1, -1):
            corners = [
                np.array(OBJECT_LOCATION_M)
                + side * half[axis] * FRAME[axis]
                + p * half[b] * FRAME[b]
                + q * half[c] * FRAME[c]
                for p, q in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ]
            z = z + hidden_phasors(
                SMALL.width,
                SMALL.height,
                FREQUENCIES_HZ,
                corners,
                side * FRAME[axis],
                camera=CAMERA_LOCATION_M,
                axes=AXES,
                camera_fov_deg=HORIZONTAL_FOV_DEG,
                projector_fov_deg=PROJECTOR_FOV_DEG,
                order=24,
                convex=True,
            )
    return z


def moved_by(metres):
    return trimesh.transformations.translation_matrix(metres * np.array([1, -1, 0.5]))


@pytest.mark.parametrize(
    ("thickness_m", "scaled", "moved_m"),
    [
        (0.02, 1, 0),
        (0.0005, 1, 0),
        (0.00005, 1, 0),
        (0.0005, 1, 40),  # float32 knows a place 40 m away to 4 um
        (0.0001, 10, 0),
        (0.0001, 0.1, 0),
    ],
)
def test_a_thin_closed_plate_sends_the_light_of_its_front_once(
    variant, tmp_path, thickness_m, scaled, moved_m
):
    corner = OddCorner((plate(thickness_m),), has_middle_wall=False, scaled=scaled, moved=moved_by(moved_m))
    # Lengths and wavelengths grow together. The flux stays, so the radiance falls with the area.
    frequencies_hz = tuple(np.array(FREQUENCIES_HZ) / scaled)
    image = measure(corner.load(tmp_path), variant, lights=512, layout=SMALL, frequencies_hz=frequencies_hz)
    assert image.error < 0.025
    assert np.all(relative(image.hidden * scaled**2, plate_phasors(thickness_m)) < image.error)


# Sharp edges


def inner_lights(mesh, lights):
    """(N,) lights that shine into a convex mesh: on the inner side of every face that they lie on."""
    off_m = ((lights.position[:, None] - mesh.triangles_center) * mesh.face_normals).sum(axis=-1)
    outwards = lights.normal @ mesh.face_normals.T > 0.999
    return ~((np.abs(off_m) < 1e-5) & outwards).any(axis=1)


def wedge(angle_deg, length_m=0.3):
    """A closed wedge whose edge points to the wall."""
    half = length_m * np.tan(np.radians(angle_deg / 2))
    corners = [(x, y, z) for z in (-0.2, 0.2) for x, y in ((0, 0), (length_m, half), (length_m, -half))]
    mesh = trimesh.Trimesh(corners).convex_hull
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.3, [0, 0, 1]))
    return mesh.apply_translation(np.array(OBJECT_LOCATION_M) - mesh.centroid)


@pytest.mark.parametrize(
    "mesh",
    [
        pytest.param(box(), id="cube"),
        pytest.param(plate(0.0005), id="foil"),
        pytest.param(ball(3), id="ball", marks=pytest.mark.thorough),
        pytest.param(wedge(5), id="blade"),
        pytest.param(wedge(1), id="razor", marks=pytest.mark.long),
    ],
)
def test_light_stays_out_of_a_closed_object(variant, tmp_path, mesh):
    lights = expose(Corner((mesh,)).load(tmp_path), variant, lights=8192, layout=SMALL).field.lights
    assert len(lights) > 2000
    # Rays start 5 um from a surface (kernels/visibility.py), so light gets in 5 um around an edge: with 1 to
    # 2 m of sharp edges on 0.2 m², that is at most 1e-4 of the points. One millimetre would let in 80.
    assert inner_lights(mesh, lights).sum() <= 4


def test_an_object_in_a_closed_box_gets_no_light_at_all(variant, tmp_path):
    scene = Corner((ball(3, 0.1),), blockers=(box(),)).load(tmp_path)
    with pytest.raises(HiddenSurfaceError, match="no hidden object can be seen from the lit relay wall"):
        expose(scene, variant, layout=SMALL)


def test_an_object_in_a_hidden_box_adds_nothing(variant, tmp_path):
    outer = box((0.5, 0.5, 0.01))
    scene = Corner((outer, ball(2, 0.004))).load(tmp_path)
    lights = expose(scene, variant, lights=2048, layout=SMALL).field.lights
    off_m = np.linalg.norm(lights.position - np.array(OBJECT_LOCATION_M), axis=1)
    assert not (off_m < 0.0045).any()
