"""``night-render`` with the method ``batched``: which scenes it renders, and that each is on its own."""

import shutil

import numpy as np
import pytest
import trimesh
from numpy.linalg import norm
from ring_scenes import RING, scenes_with_rings

from itof import DepthMap, read_image
from render.rendering import Renderer
from render.settings import settings_for
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, open_dataset

TABLES = {
    "dataset": {"count": 5, "seed": 4},
    "camera": {"width": 32, "height": 24},
    "camera_spread": {"location_m": 0.2, "rotation_deg": 4.0},
    "hidden_object": {"shapes": ["cube", "sphere", RING], "composite_fraction": 0.4},
}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Folder of five scenes in many corners; some have a ring, some two objects."""
    dataset = scenes_with_rings(tmp_path_factory.mktemp("rings"), TABLES)
    parts = [[part.shape for part in dataset.scene(each).hidden_objects] for each in dataset.ids()]
    assert any(RING in shapes for shapes in parts)
    assert any(len(shapes) > 1 for shapes in parts)
    return dataset.root


@pytest.fixture
def copied(scenes, tmp_path):
    return open_dataset(shutil.copytree(scenes, tmp_path / "data"))


def renderer(dataset, **given):
    return Renderer(dataset, settings_for(dataset, {"device": "cpu", "product": "itof"} | given))


def methods(records):
    return [each if isinstance(each, Exception) else each.attributes["method"] for each in records]


def test_files_do_not_depend_on_the_other_scenes_of_a_job(copied):
    ids = copied.ids()
    found = []
    for jobs in ([ids], [[each] for each in reversed(ids)]):
        one = renderer(copied, error=0.05)
        records = {}
        for job in jobs:
            records |= dict(zip(job, one.render_all(job), strict=True))
        assert methods(records.values()) == ["batched"] * 5
        found.append({each: (records[each].files, records[each].attributes) for each in ids})
    assert found[0] == found[1]


def test_phasors_and_ground_truth_are_those_of_many_lights(copied):
    images, ids = [], copied.ids()[:3]
    for settings in ({"error": 0.02}, {"method": "many-light", "error": 0.01}):
        records = list(renderer(copied, **settings).render_all(ids))
        images.append(
            [read_image(copied.render_folder(each) / MEASUREMENT_FILE) for each in ids]
            + [DepthMap.of_image(read_image(copied.render_folder(each) / GROUND_TRUTH_FILE)) for each in ids]
        )
        errors = [float(record.attributes["hidden_error"]) for record in records]
        assert max(errors) <= settings["error"]
    for found, expected in zip(*images, strict=True):
        if isinstance(found, DepthMap):
            assert np.array_equal(found.mask, expected.mask)
            # float32 rounds 5 m by 2.4e-7 m, and some ten operations do.
            assert np.abs(found.radial_depth_m - expected.radial_depth_m).max() < 1e-5
        else:
            one, other = (each.phasors("hidden")[0] for each in (found, expected))
            assert norm(one - other) / norm(other) < np.hypot(0.02, 0.01)  # the errors asked for


def test_what_the_engine_cannot_render_goes_to_many_lights(copied):
    first, second, *_ = copied.ids()
    mesh = copied.scene_folder(first) / "hidden_object_0.ply"
    moved = trimesh.load(mesh, process=False)
    moved.vertices = moved.vertices + 1e-3
    mesh.write_bytes(moved.export(file_type="ply"))
    accepted = renderer(copied, error=0.2, accept_edited=True)
    assert methods(accepted.render_all([first, second])) == ["many-light", "batched"]
    deeper = renderer(copied, error=0.2, max_bounces=4)
    assert methods(deeper.render_all([second])) == ["many-light"]


def test_a_damaged_mesh_is_named_and_the_other_scenes_of_its_job_are_rendered(copied):
    ringed = next(each for each in copied.ids() if copied.scene(each).hidden_objects[0].shape == RING)
    other = next(each for each in copied.ids() if each != ringed)
    mesh = copied.scene_folder(ringed) / "hidden_object_0.ply"
    mesh.write_bytes(mesh.read_bytes()[:-40])
    accepted = renderer(copied, error=0.2, accept_edited=True)
    damaged, fine = accepted.render_all([ringed, other])
    assert "hidden_object_0.ply" in str(damaged)
    assert methods([fine]) == ["batched"]
