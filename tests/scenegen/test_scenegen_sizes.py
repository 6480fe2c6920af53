"""Scenes of other sizes, and empty corners: what is drawn, in which order, and what is refused."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter

from disk import PresetError
from scenegen import Preset, preset_from_dict, sample_scene, scene_from_json, scene_to_json
from scenegen.depth_range import largest_mirrored_depth_m, largest_radius_m
from scenegen.sampling import class_and_split

SIZES = [0.3, 2.0]
DRAWN = {  # everything that is drawn after the objects
    "camera_spread": {"location_m": 0.2, "rotation_deg": 4.0, "horizontal_fov_deg": 5.0},
    "relay_wall": {"least_reflectance": 0.4},
}


def preset(**hidden):
    return preset_from_dict({**DRAWN, "hidden_object": {"least_reflectance": 0.2, **hidden}}, "a test")


def factors(scenes, of):
    sizes_m = of.hidden_object.size_m
    return [[side / usual for side, usual in zip(part.size_m, sizes_m.of(part.shape), strict=True)]
            for scene in scenes for part in scene.hidden_objects]  # fmt: skip


def test_sizes_are_drawn_evenly_in_the_logarithm_and_keep_the_shape():
    settings = preset(size_factor=SIZES, composite_fraction=0.0)
    found = np.array(factors([sample_scene(settings, index) for index in range(1200)], settings))  # (1200, 3)
    np.testing.assert_allclose(found, found[:, :1] * np.ones(3), rtol=1e-12)
    low, high = np.log(SIZES)
    along = (np.log(found[:, 0]) - low) / (high - low)
    # All of 1200 values miss a hundredth of the range with the probability 0.99^1200 = 6e-6.
    assert 0 <= along.min() < 0.01
    assert 0.99 < along.max() < 1
    # The mean of n even values in [0, 1] has the standard deviation 1 / sqrt(12 n).
    assert abs(along.mean() - 0.5) < 5 / np.sqrt(12 * len(along))
    assert abs((along < 0.25).mean() - 0.25) < 5 * np.sqrt(0.25 * 0.75 / len(along))


def test_a_size_is_drawn_after_all_else_and_enlarges_a_composite_as_a_whole():
    usual, sized = preset(composite_fraction=0.5), preset(composite_fraction=0.5, size_factor=SIZES)
    for index in range(20):
        one, other = sample_scene(usual, index), sample_scene(sized, index)
        assert replace(other, hidden_objects=one.hidden_objects) == one
        (factor, *_), *rest = factors([other], sized)
        for part, same in zip(other.hidden_objects, one.hidden_objects, strict=True):
            assert replace(part, size_m=same.size_m, location_m=same.location_m) == same
        if rest:
            assert rest[0] == pytest.approx([factor] * 3)
            (first, second), (small, beside) = other.hidden_objects, one.hidden_objects
            assert first.location_m == small.location_m
            np.testing.assert_allclose(
                np.subtract(second.location_m, first.location_m),
                factor * np.subtract(beside.location_m, small.location_m),
                atol=1e-12,
            )


def test_every_fourth_scene_is_empty_and_the_others_are_those_without_empty_corners():
    with_empty, without = preset(empty_fraction=0.25), preset()
    classes = [class_and_split(with_empty, index)[1:] for index in range(400)]
    assert all(Counter(name for name, _ in classes[n : n + 4])["no_object"] == 1 for n in range(0, 400, 4))
    shapes = [name for name, _ in classes if name != "no_object"]
    assert shapes == [class_and_split(without, index)[1] for index in range(300)]
    splits = Counter(split for name, split in classes if name == "no_object")
    assert splits == {"test": 20, "validation": 16, "train": 64}  # 0.2 of 100, and 0.2 of the rest
    empty = [sample_scene(with_empty, n) for n, (name, _) in enumerate(classes[:40]) if name == "no_object"]
    assert all(scene.hidden_objects == () for scene in empty)
    assert len({scene.camera for scene in empty}) == len({scene.relay_wall for scene in empty}) == 10
    assert scene_from_json(scene_to_json(empty[0]), "here") == empty[0]
    assert {class_and_split(preset(empty_fraction=1.0), index)[1] for index in range(9)} == {"no_object"}


def test_keys_that_change_nothing_are_in_no_file():
    given = preset(size_factor=[1, 1], empty_fraction=0)
    assert given == preset()
    assert (
        not {"size_factor", "empty_fraction"} & TypeAdapter(Preset).dump_python(given)["hidden_object"].keys()
    )


def test_the_largest_size_counts_for_radius_and_depth():
    one = preset(composite_fraction=0.0)
    twice = preset(composite_fraction=0.0, size_factor=[0.1, 2.0])
    assert largest_radius_m(twice) == pytest.approx(2 * largest_radius_m(one))
    assert largest_mirrored_depth_m(twice) - largest_mirrored_depth_m(one) == pytest.approx(
        largest_radius_m(one)
    )


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        ({"size_factor": [2, 1]}, r"size_factor: .*range \[2, 1\] is empty"),
        ({"size_factor": [0, 1]}, "size_factor.*must be 0.01 to 100"),
        ({"size_factor": [0.01, 1], "shapes": ["mesh:a.ply", "cube"], "size_m": {"mesh": 1e-3}},
         r"size_factor = 0.01, times an extent of 0.001 m, must be 0.0001 to 1000 m \(got 1e-05\)"),
        ({"empty_fraction": 1.1}, "empty_fraction"),
    ],
)  # fmt: skip
def test_impossible_sizes_and_shares_are_refused(hidden, said):
    with pytest.raises(PresetError, match=said):
        preset(**hidden)
