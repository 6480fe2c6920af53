"""The relay wall's material against Mitsuba's, and solids against meshes and closed forms."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from model.refinement.light.rough_wall import reflected
from model.refinement.light.solids import KIND_OF_SHAPE, Solid
from scenegen.preset import ShapeSizes

NORMAL = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
SIZES = {shape: ShapeSizes().of(shape) for shape in KIND_OF_SHAPE}
TURNED = Rotation.from_euler("xyz", [25, -35, 50], degrees=True).as_matrix()
CENTRE_M = np.array([0.3, -0.2, 2.0])


def solid(shape):
    return Solid(shape, SIZES[shape], CENTRE_M, TURNED)


def directions(count, seed):
    """(count, 3) directions in front of the wall, up to 84 degrees from its normal."""
    rng = np.random.default_rng(seed)
    z, azimuth = rng.uniform(0.1, 1, count), rng.uniform(0, 2 * np.pi, count)
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.55, 0.77, 1.0])
def test_the_material_is_mitsubas_roughplastic(variant, roughness):
    import drjit as dr
    import mitsuba as mi

    plastic = {"type": "roughplastic", "alpha": roughness, "diffuse_reflectance": 0.8}
    towards, leaving = directions(3000, 1), directions(3000, 2)
    si = dr.zeros(mi.SurfaceInteraction3f, len(towards))
    si.wi = mi.Vector3f(*(mi.Float(column) for column in towards.T))
    out = mi.Vector3f(*(mi.Float(column) for column in leaving.T))
    expected = np.array(mi.load_dict(plastic).eval(mi.BSDFContext(), si, out).x)
    found = reflected(torch.as_tensor(towards), torch.as_tensor(leaving), NORMAL, roughness, 0.8).numpy()
    # Both interpolate tables; Mitsuba's have one roughness, ours are linear between steps of 0.05.
    np.testing.assert_allclose(found, expected, rtol=0.01)


def test_no_light_is_reflected_behind_the_wall_and_a_diffuse_wall_is_lamberts():
    towards, leaving = torch.as_tensor(directions(50, 3)), torch.as_tensor(directions(50, 4))
    assert not reflected(towards, -leaving, NORMAL, 0.5).any()
    assert not reflected(-towards, leaving, NORMAL, None).any()
    diffuse = reflected(towards, leaving, NORMAL, None, 0.7)
    torch.testing.assert_close(diffuse, 0.7 / np.pi * leaving[:, 2])


AREAS_M2 = {
    "cube": 6 * 0.5**2,
    "parallelepiped": 2 * (0.3**2 + 2 * 0.3 * 0.6),
    "sphere": np.pi * 0.56**2,
    "cylinder": np.pi * 0.4 * 0.55 + 2 * np.pi * 0.2**2,
    "cone": np.pi * 0.28 * np.hypot(0.28, 0.55) + np.pi * 0.28**2,
    "concave_plane": 0.589 / np.sin(1) * 0.6,  # an arc of 2 rad of radius chord / 2 sin(1)
}


@pytest.mark.parametrize("shape", KIND_OF_SHAPE)
@pytest.mark.parametrize("fine", [True, False])
def test_surfaces_have_the_area_and_normals_of_the_solid(shape, fine):
    points, normals, areas = solid(shape).surface(fine)
    assert areas.sum() == pytest.approx(AREAS_M2[shape], rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    # a ray from outside along the normal ends at the point: it is on the surface, and the normal is outward
    start = torch.as_tensor(points + 0.01 * normals)
    hit = solid(shape).first_hit(start, torch.as_tensor(-0.02 * normals)).numpy()
    np.testing.assert_allclose(hit, 0.5, atol=1e-6)
    if not solid(shape).is_sheet:  # Gauss: the flux of the position is three volumes
        flux = ((points - CENTRE_M) * normals).sum(1) @ areas
        volume = {
            "cube": 0.5**3,
            "parallelepiped": 0.3 * 0.3 * 0.6,
            "sphere": np.pi / 6 * 0.56**3,
            "cylinder": np.pi * 0.2**2 * 0.55,
            "cone": np.pi / 3 * 0.28**2 * 0.55,
        }[shape]
        assert flux == pytest.approx(3 * volume, rel=1e-9)


@pytest.mark.parametrize("shape", KIND_OF_SHAPE)
def test_rays_meet_solids_where_they_meet_the_meshes_of_scenes(shape, make_dataset, variant):
    import mitsuba as mi

    place = dict(zip("xyz", ([v, v] for v in (1.1, 0.9, 1.6)), strict=True))
    angles = dict(zip("xyz", ([v, v] for v in (25, -35, 50)), strict=True))
    hidden = {"shapes": [shape], "composite_fraction": 0.0, "location_m": place, "rotation_deg": angles}
    dataset = make_dataset({"dataset": {"count": 1}, "hidden_object": hidden})
    scene = dataset.scene("000000")
    file = dataset.root / "scenes" / "000000" / "hidden_object_0.ply"
    mesh = mi.load_dict({"type": "scene", "mesh": {"type": "ply", "filename": str(file)}})
    turned = Rotation.from_euler("xyz", scene.hidden_objects[0].rotation_deg, degrees=True).as_matrix()
    size_m = scene.hidden_objects[0].size_m
    placed = Solid(shape, size_m, np.asarray(scene.hidden_objects[0].location_m), turned)
    rng = np.random.default_rng(5)
    origin = np.array([-1.0, -0.7, 1.4])
    towards = placed.centre_m - origin + rng.uniform(-0.35, 0.35, (400, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    found = placed.first_hit(torch.as_tensor(origin), torch.as_tensor(towards)).numpy()
    ray = mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*(mi.Float(column) for column in towards.T)))
    expected = np.array(mesh.ray_intersect(ray).t)
    both = np.isfinite(found) & np.isfinite(expected)
    assert both.sum() > 60
    assert (np.isfinite(found) == np.isfinite(expected)).mean() > 0.99  # a chord is 0.3 mm inside its arc
    apart_m = np.abs(found[both] - expected[both])
    assert np.median(apart_m) < 1e-3
    assert np.quantile(apart_m, 0.98) < 5e-3  # at grazing incidence


@pytest.mark.parametrize("shape", KIND_OF_SHAPE)
def test_the_inside_is_where_rays_meet_a_surface_in_every_direction(shape):
    rng = np.random.default_rng(6)
    points = CENTRE_M + rng.uniform(-0.4, 0.4, (300, 3))
    ways = rng.normal(size=(40, 3))
    placed = solid(shape)
    hits = placed.first_hit(torch.as_tensor(points)[:, None], torch.as_tensor(ways)[None])
    surrounded = hits.isfinite().all(1).numpy()
    assert (placed.contains(points) == surrounded).all()
    assert surrounded.any() != placed.is_sheet


def test_a_cube_stays_a_cube_when_it_is_stretched_and_a_box_does_not():
    assert solid("cube").stretched(np.log([1.1])).size_m == pytest.approx((0.55, 0.55, 0.55))
    grown = solid("parallelepiped").stretched(np.log([1.0, 2.0, 0.5]))
    assert grown.size_m == pytest.approx((0.3, 0.6, 0.3))
    assert solid("cylinder").stretched(np.log([1.5, 1.0])).size_m == pytest.approx((0.6, 0.6, 0.55))
