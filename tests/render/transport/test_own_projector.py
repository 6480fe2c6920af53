"""Projectors with a place, a field of view or dots of their own, against an independent quadrature."""

import json

import numpy as np
import pytest
from batch_quadrature import CubeLight

from disk.preset_files import PresetError
from itof import MeasurementMatrix, TransientLayout
from model.data.corner import ProjectorError, wall_view
from render.batch.light import suits
from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.scene_loading import load_scene
from scenegen import preset_from_dict, sample_scene
from scenegen.mitsuba_description import emitter_pfm
from scenegen.scene import scene_to_json

HZ = (20e6, 60e6)
LAYOUT = TransientLayout(32, 24, 1500, 0.01, 0.0)
ERROR = 0.01
ASIDE = {"location_m": [1.3, -1.4, 1.8], "rotation_deg": [88.0, 0.0, 42.0]}
PROJECTORS = {
    "displaced": ASIDE,
    "narrow": {"horizontal_fov_deg": 25.0},
    "spot": {"horizontal_fov_deg": 0.5, "dots": [1, 1], **ASIDE},
    "line": {"horizontal_fov_deg": 40.0, "dots": [20, 1], **ASIDE},
    "grid": {"dots": [8, 6], "spacing": 7, **ASIDE},
}


def settings(projector):
    return {
        "dataset": {"count": 1, "seed": 2},
        "hidden_object": {"shapes": ["cube"], "composite_fraction": 0.0},
        "relay_wall": {"material": "diffuse"},
        "camera": {"width": LAYOUT.width, "height": LAYOUT.height},
        "projector": projector,
    }


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=() if name in ("displaced", "grid") else pytest.mark.long)
        for name in PROJECTORS
    ],
)
def exposed(request, make_dataset, variant):
    """A dataset of one cube, its scene, and an exposure with `many-light`."""
    dataset = make_dataset(settings(PROJECTORS[request.param]))
    method = ManyLight(ManyLightOptions(error=ERROR), variant)
    exposure = method.expose(load_scene(dataset, dataset.ids()[0]), View(LAYOUT, HZ, 3, 1))
    return dataset, dataset.scene(dataset.ids()[0]), exposure


def test_hidden_light_is_that_of_the_quadrature(exposed):
    _, scene, exposure = exposed
    size = (LAYOUT.width, LAYOUT.height)
    coarse, fine = (CubeLight(scene, HZ, *order) for order in cells_of(scene))
    coarse, fine = (each.hidden(*each.centres(2 * size[0], 2 * size[1])) for each in (coarse, fine))
    coarse, fine = (each.reshape(size[1], 2, size[0], 2, -1).mean((1, 3)) for each in (coarse, fine))
    missed = np.linalg.norm(exposure.phasors().hidden - fine) / np.linalg.norm(fine)
    # The error of even cells falls with at least the first power of their number, as in `test_batch_light`.
    assert missed < np.hypot(ERROR, 2 * np.linalg.norm(fine - coarse) / np.linalg.norm(fine))


def cells_of(scene):
    """Cells of a dot or of the film, and nodes of a face: a dot is small."""
    return ((1, 8), (2, 12)) if scene.emitter.dots else ((8, 8), (12, 12))


def test_direct_light_is_that_of_the_quadrature(exposed):
    """Cells of the projector's film are given to pixels as a whole: those at edges make the error.

    How large it is depends on how the edges lie in the pixels, so the limits are chosen, not derived.
    """
    _, scene, exposure = exposed
    cells = 40 if scene.emitter.dots else 300
    expected = CubeLight(scene, HZ, 1, 1).direct_image(LAYOUT.width, LAYOUT.height, cells)
    found = exposure.phasors().direct
    total = np.abs(found.sum((0, 1)) / expected.sum((0, 1)) - 1).max()
    missed = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert total < 1e-3
    assert missed < 0.03
    assert ((found == 0) == (expected == 0)).mean() > 0.99


def test_transients_have_the_phasors_of_the_measurement(exposed):
    _, _, exposure = exposed
    phi = MeasurementMatrix(HZ, LAYOUT.bin_count, LAYOUT.bin_width_m, splat="quadratic")
    found = phi.apply_streaming(exposure.row_blocks())
    image = exposure.phasors()
    # docs/science/renderer.md: 1 % of the hidden part
    assert np.linalg.norm(found - image.direct - image.hidden) < 0.01 * np.linalg.norm(image.hidden)


@pytest.mark.parametrize("name", PROJECTORS)
def test_networks_and_the_batched_engine_take_a_flash_alone(make_dataset, name):
    dataset = make_dataset(settings(PROJECTORS[name]))
    assert not suits(dataset.scene(dataset.ids()[0]))
    with pytest.raises(ProjectorError, match="projector of its own"):
        wall_view(dataset)


def test_a_projector_as_the_camera_changes_no_file():
    plain = sample_scene(preset_from_dict({}, "test"), 0)
    own = {"location_m": [1.0, -1.0, 1.65], "rotation_deg": [90.0, 0.0, 50.0], "horizontal_fov_deg": 60.0}
    given = sample_scene(preset_from_dict({"projector": own}, "test"), 0)
    assert scene_to_json(given) == scene_to_json(plain)
    assert "dots" not in json.loads(scene_to_json(plain))["emitter"]


def test_each_dot_is_the_middle_of_its_cell():
    scene = sample_scene(preset_from_dict(settings({"dots": [3, 2], "spacing": 3}), "test"), 0)
    header, pixels = emitter_pfm(scene).split(b"-1.0\n", 1)
    image = np.frombuffer(pixels, "<f4").reshape(12, 18)
    assert header == b"Pf\n18 12\n"
    assert np.argwhere(image[::2, ::2]).tolist() == [[row, column] for row in (1, 4) for column in (1, 4, 7)]


@pytest.mark.parametrize(
    ("projector", "reason"),
    [
        ({"dots": [8, 6], "spacing": 4}, "odd"),
        ({"spacing": 3}, "give dots"),
        ({"dots": [9000, 9000]}, "too large"),
    ],
)
def test_impossible_dots_are_refused(projector, reason):
    with pytest.raises(PresetError, match=reason):
        preset_from_dict(settings(projector), "test")
