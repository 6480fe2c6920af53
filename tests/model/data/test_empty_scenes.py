"""Networks and scenes without an object: losses, fresh scenes, training, judging."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from night_commands import night_here
from scene_views import shown
from synthetic_dataset import write_synthetic_dataset
from training_runs import FLIP, settings

from model.judging.groups import group_tables
from model.network.loss import MaskAndDepthLoss
from model.network.mask_and_depth import MaskAndDepth
from model.refinement.family import family_of
from model.settings.fresh import FreshScenes
from model.training.fresh.workers import Rendering
from model.training.loop import train
from scenegen import preset_from_dict

pytestmark = pytest.mark.usefixtures("one_thread")
RANGES = ((1.0, 1.3), (0.5, 1.3), (1.25, 1.95))


@pytest.mark.parametrize("uncertainty", [False, True])
def test_an_image_without_an_object_teaches_its_mask_alone(uncertainty):
    readout = MaskAndDepth(20e6, depth_mean_m=3.0, depth_spread_m=0.5, has_uncertainty=uncertainty)
    channels, nothing = 2 + uncertainty, torch.zeros(1, 3, 5)
    for logit in (-60.0, -3.0, 0.0, 60.0):
        output = torch.full((1, channels, 3, 5), logit, requires_grad=True)
        value = MaskAndDepthLoss(readout)(output, torch.zeros(1, 2, 3, 5), nothing, nothing)
        # cross entropy log(1 + e^x), and an overlap of 0
        assert value.item() == pytest.approx(1 + np.logaddexp(0, max(logit, -40)), rel=1e-5)
        value.backward()
        assert (output.grad[:, 1:] == 0).all()
        p = 1 / (1 + np.exp(-logit)) if logit > -40 else 0
        np.testing.assert_allclose(output.grad[:, 0], p / 15, rtol=1e-5)


def test_a_stream_with_empty_corners_has_no_light_and_no_target_in_them():
    tables = {"camera": {"width": 24, "height": 14}, "hidden_object": {"empty_fraction": 0.5}}
    stream = FreshScenes(preset_from_dict(tables, "a test")).with_seed(5)
    rendering = Rendering(stream, {}, 24, 14, 0.1, "cpu", 1)
    light = rendering.light()
    are_empty = [not stream.scene(index, {}).hidden_objects for index in range(4)]
    assert sum(are_empty) == 2
    block = rendering.rows(light, range(4))
    for row, is_empty in enumerate(are_empty):
        assert is_empty == (not block.mask[row].any())
        assert is_empty == (not block.target[row].any())
    first = are_empty.index(True)
    alone = rendering.rows(light, [first])  # no light at all is right
    assert np.array_equal(alone.phasors[0], block.phasors[first])


def test_averages_of_empty_corners_are_a_group_of_their_own():
    full = [shown(f"{n:06d}").result for n in range(3)]
    nothing = shown("000003", "no_object", truth=((0, 0), (0, 0), 2.5)).result
    found = group_tables([*full, replace(nothing, location_m=None)], RANGES)
    by_key = {table.key: {group.name: group for group in table.groups} for table in found}
    for key in ("object_class", "composite", "x_m", "y_m", "z_m"):
        group = by_key[key]["no object"]
        assert (group.count, group.object_mae_m, group.no_object_mae_m) == (1, None, 0.0)
        # the prediction shows 6 x 10 of 12 x 20 pixels at 2.8 m, and the truth none
        assert group.depth_mae_m == pytest.approx(2.8 * 60 / 240)
        assert group.miou == pytest.approx((0 + 180 / 240) / 2)
    assert list(by_key["composite"]) == ["simple", "no object"]
    assert list(by_key["x_m"])[-1] == "no object"


def test_sizes_that_vary_are_fitted():
    one = preset_from_dict({}, "a test")
    sized = preset_from_dict({"hidden_object": {"size_factor": [0.5, 2]}}, "a test")
    assert not family_of(one, ()).fits_sizes
    assert family_of(sized, ()).fits_sizes
    assert family_of(sized, ()).sizes == family_of(one, ()).sizes


def test_a_network_learns_and_is_judged_on_scenes_some_of_which_are_empty(tmp_path):
    data = write_synthetic_dataset(tmp_path / "data", count=12, hidden_object={"empty_fraction": 0.4})
    train(data, tmp_path / "run", settings(**FLIP | {"target": "mask+depth", "width": 4, "batch_size": 4}))
    report = tmp_path / "report"
    done = night_here("night-eval", tmp_path / "run", data.root, "--out", report, "--device", "cpu")
    assert done.returncode == 0, done.stderr
    assert "| no object | " in (report / "summary.md").read_text()
    rows = (report / "metrics.csv").read_text().splitlines()
    line = next(each for each in rows if ",no_object," in each)
    assert ",,," in line  # no place
