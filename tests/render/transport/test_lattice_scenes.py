"""The interpolated image against every pixel computed, by the same lights: on the paper's shapes and on walls
with texture and bumps."""

from dataclasses import dataclass, replace

import many_light_scenes as corner
import numpy as np
import pytest
from many_light_scenes import CAMERA_LOCATION_M, FREQUENCIES_HZ, ball, box, relative
from odd_corners import OddCorner

from itof import MeasurementMatrix, TransientLayout
from render.options import ManyLightOptions
from render.transport.lights.run_statistics import relative_bound
from render.transport.many_light import ManyLight, hidden_rule
from render.transport.method import View
from render.transport.passes.gather_pass import gather_runs
from render.transport.passes.hidden_pass import first_lattice
from render.transport.scene_loading import load_scene

SMALL = TransientLayout(40, 30, 1400, 0.01, 0.0)
LARGE = TransientLayout(80, 60, 1400, 0.01, 0.0)
# The interpolation may have what the lights leave of the wanted error, or a quarter of it, which 128 points
# measure. The whole image may have half as much again: an error in few pixels is known to 1/sqrt(2 x 10) from
# ten points that hit it.
MARGIN = 1.5


def exposure_of(scene, variant, wanted, layout=SMALL):
    return ManyLight(ManyLightOptions(error=wanted), variant).expose(
        scene, View(layout, FREQUENCIES_HZ, 3, 1)
    )


def exact_image(exposure):
    """(H, W, F) hidden phasors with every pixel computed."""
    field = replace(exposure.field, lattice=None)
    return field.image(
        exposure._grid, hidden_rule(exposure._grid.width), exposure.direct_image, 0.1 * exposure.wanted
    ).phasors


def interpolation_error(exposure):
    return relative(exposure.phasors().hidden, exact_image(exposure)).max()


def left_by_lights(exposure):
    """Error that the interpolation may have beside that of the lights."""
    nodes = first_lattice(exposure.view.layout.width / exposure.view.layout.height).nodes
    random = relative_bound(gather_runs(exposure.scene, nodes, FREQUENCIES_HZ, exposure.field.lights)).max()
    assert np.hypot(random, exposure.wanted / 4) < 1.01 * exposure.wanted
    left = np.sqrt(max(0, exposure.wanted**2 - random**2))
    return MARGIN * max(exposure.wanted / 4, left)


@pytest.mark.parametrize("wanted", [0.02, pytest.param(0.005, marks=pytest.mark.thorough)])
def test_a_glossy_wall_is_interpolated_with_what_lights_leave_of_the_wanted_error(variant, tmp_path, wanted):
    scene = OddCorner((box(),), wall_bsdf=corner.rough_plastic(0.3)).load(tmp_path)
    exposure = exposure_of(scene, variant, wanted)
    assert exposure.field.lattice is not None
    assert interpolation_error(exposure) < left_by_lights(exposure)


@pytest.mark.long
@pytest.mark.parametrize("wanted", [0.01, pytest.param(0.003, marks=pytest.mark.thorough)])
@pytest.mark.parametrize(
    "shapes",
    [
        pytest.param(["sphere"], id="sphere", marks=pytest.mark.thorough),
        pytest.param(["concave_plane"], id="concave_plane"),
        pytest.param(["cone", "cylinder"], id="cone+cylinder"),
    ],
)
def test_shapes_are_interpolated_with_what_lights_leave_of_the_wanted_error(
    make_dataset, variant, shapes, wanted
):
    preset = corner._one_scene(shapes, 0.3, int(len(shapes) > 1))
    exposure = exposure_of(load_scene(make_dataset(preset), "000000"), variant, wanted, LARGE)
    assert exposure.field.lattice is not None
    assert interpolation_error(exposure) < left_by_lights(exposure)


# Walls with texture and bumps


@dataclass(frozen=True)
class TexturedCorner(OddCorner):
    """A corner whose relay wall is a square of 12 m with texture coordinates."""

    def _shape(self, folder, name, mesh, bsdf):
        import mitsuba as mi

        if name != "relay_wall":
            return super()._shape(folder, name, mesh, bsdf)
        middle = [0.0, 0.0, CAMERA_LOCATION_M[2]]
        pose = mi.ScalarTransform4f().translate(middle).rotate([0, 1, 0], 90).scale(6)
        return {"type": "rectangle", "to_world": pose, "bsdf": bsdf}


def texture(pattern):
    """A texture of eight periods over the wall."""
    import mitsuba as mi

    y, x = np.mgrid[:64, :64] / 64
    values = {
        "waves": 0.5 + 0.4 * np.sin(6 * np.pi * x) * np.cos(8 * np.pi * y),
        "checks": 0.3 + 0.6 * (((8 * x).astype(int) + (8 * y).astype(int)) % 2),
        "holes": 0.8 * (((2 * x).astype(int) + (2 * y).astype(int)) % 2),  # half of it is black
    }[pattern]
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(values[..., None].astype(np.float32)),
        "raw": True,
        "to_uv": mi.ScalarTransform3f().scale([8, 8]),
        "filter_type": "nearest" if pattern in ("checks", "holes") else "bilinear",
    }


def normals():
    """A normal map: normals that lean up to 12 degrees."""
    import mitsuba as mi

    y, x = np.mgrid[:64, :64] / 64
    lean = 0.15 * np.sin(6 * np.pi * x), 0.15 * np.cos(4 * np.pi * y)
    direction = np.stack([*lean, np.ones_like(x)], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    image = mi.Bitmap((direction / 2 + 0.5).astype(np.float32))
    return {"type": "bitmap", "bitmap": image, "raw": True, "to_uv": mi.ScalarTransform3f().scale([8, 8])}


def wall(kind, pattern):
    shiny = {"type": "roughplastic", "alpha": 0.3}
    nested = {
        "texture": lambda: {"type": "diffuse", "reflectance": texture(pattern)},
        "bumps": lambda: {"type": "bumpmap", "arbitrary": texture(pattern), "scale": 0.02, "bsdf": shiny},
        "normals": lambda: {"type": "normalmap", "normalmap": normals(), "bsdf": shiny},
    }[kind]()
    return {"type": "twosided", "nested": nested}


@pytest.mark.parametrize(
    ("kind", "pattern"),
    [
        pytest.param("texture", "checks", marks=pytest.mark.thorough),
        pytest.param("texture", "holes", marks=pytest.mark.long),
        pytest.param("bumps", "waves", marks=pytest.mark.long),
        pytest.param("normals", "", marks=pytest.mark.long),
    ],
)
def test_the_hidden_part_of_a_wall_with_texture_or_bumps_is_interpolated_as_well(
    variant, tmp_path, kind, pattern
):
    wanted = 0.04
    scene = TexturedCorner((ball(2),), wall_bsdf=wall(kind, pattern)).load(tmp_path)
    exposure = exposure_of(scene, variant, wanted)
    image = exposure.phasors()
    assert relative(image.hidden, exact_image(exposure)).max() < left_by_lights(exposure)
    assert np.isfinite(image.total).all()
    # In the transient as well: what an image with the object has more than one without lights.
    phi = MeasurementMatrix(FREQUENCIES_HZ, 1400, 0.01, splat="quadratic")
    dark = replace(exposure, field=None)
    vars(dark).update(
        direct_image=exposure.direct_image, _rule=exposure._rule
    )  # nodes that the hidden part needs
    with_lights, without = (phi.apply(np.concatenate(list(one.row_blocks()))) for one in (exposure, dark))
    # Phasors and bins have their own nodes, which see other parts of a black texel within a pixel: by no more
    # than the image states.
    allowed = image.error if pattern == "holes" else 0.005
    assert np.all(relative(with_lights - without, image.hidden) < allowed)
