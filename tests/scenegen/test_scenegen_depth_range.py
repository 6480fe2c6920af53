"""The frequencies of a preset represent every depth that its mirrored scenes can have."""

import numpy as np
import pytest
import trimesh
from night_commands import refusal

from disk import PresetError
from itof import combined_range_m, unambiguous_range_m
from scenegen import load_preset, make_dataset, preset_from_dict, sample_scene
from scenegen.depth_range import largest_mirrored_depth_m, refuse_wrapping_depths, turns_of_first_phase
from scenegen.making.meshes import with_meshes
from scenegen.pose import rotation_matrix, wall_normal
from scenegen.shapes import PRIMITIVES


def at(*frequencies_hz, **sections):
    return preset_from_dict({"itof": {"frequencies_hz": list(frequencies_hz)}, **sections}, "test")


def box_points(shape):
    """Points of a primitive in the unit box, on its surface where it is farthest from its centre."""
    t = np.linspace(0, 2 * np.pi, 65)
    ring = np.stack([np.cos(t) / 2, np.sin(t) / 2, np.full_like(t, -0.5)], axis=1)
    if shape == "sphere":
        across = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1) / 2
        return np.concatenate([np.roll(across, turn, axis=1) for turn in range(3)])
    if shape in ("cylinder", "cone"):
        return np.concatenate([ring, [[0, 0, 0.5]]])
    return np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T


def depths_m(scene):
    """Distances of the camera to the mirror images of points of the hidden objects."""
    normal, point = wall_normal(scene.relay_wall), np.array(scene.relay_wall.location_m)
    for part in scene.hidden_objects:
        placed = box_points(part.shape) * part.size_m @ rotation_matrix(part.rotation_deg).T + part.location_m
        mirrored = placed - 2 * ((placed - point) @ normal)[:, None] * normal
        yield np.linalg.norm(mirrored - scene.camera.location_m, axis=1)


def random_preset(rng):
    def ranges(low, high):
        return sorted(rng.uniform(low, high, 2).tolist())

    hidden = {
        "composite_fraction": 0.5,
        "location_m": {axis: ranges(0.2, 3) for axis in "xyz"},
        "rotation_deg": {axis: ranges(-180, 180) for axis in "xyz"},
        "composite_offset_m": ranges(-0.5, 0.5),
        "size_m": {shape: rng.uniform(0.05, 1.5, 3).tolist() for shape in PRIMITIVES},
    }
    wall = {"location_m": [rng.uniform(-1, 0), 0.0, 2.0], "rotation_deg": [0.0, rng.uniform(60, 120), 0.0]}
    camera = {"location_m": [rng.uniform(0.5, 3), -1.0, 1.65]}
    sections = {"hidden_object": hidden, "relay_wall": wall, "camera": camera}
    first_hz = float(round(np.exp(rng.uniform(np.log(5e6), np.log(60e6)))))
    return at(first_hz, 3 * first_hz, **sections)


def test_no_mirrored_depth_of_an_accepted_preset_wraps():
    rng = np.random.default_rng(5)
    accepted, wrapping = 0, 0
    for preset in (random_preset(rng) for _ in range(150)):
        scenes = [sample_scene(preset, index) for index in range(6)]
        largest_m = max(found_m.max() for scene in scenes for found_m in depths_m(scene))
        wraps = largest_m >= unambiguous_range_m(preset.itof.frequencies_hz[0])
        wrapping += wraps
        try:
            refuse_wrapping_depths(preset, {})
        except PresetError:
            continue
        accepted += 1
        assert not wraps
    assert accepted > 30
    assert wrapping > 30


def test_the_papers_presets_are_accepted():
    for name in ("paper", "demo"):
        refuse_wrapping_depths(load_preset(name), {})


def test_the_bound_is_the_farthest_depth_that_scenes_have():
    # One place, all rotations: the corner of a cube points away from the camera's mirror image in some scene.
    place = {axis: [1.3, 1.3] for axis in "xyz"}
    hidden = {"shapes": ["cube"], "composite_fraction": 0, "location_m": place}
    preset = at(20e6, hidden_object=hidden)
    bound_m = largest_mirrored_depth_m(preset, {})
    found_m = max(depth.max() for index in range(300) for depth in depths_m(sample_scene(preset, index)))
    assert found_m <= bound_m
    # A corner within 15 degrees of the direction, which 8 corners and 300 rotations reach, is lower by 3.4 %
    # of the half diagonal.
    assert found_m > bound_m - 0.034 * np.sqrt(0.75) * 0.5


def test_60_and_120_mhz_are_refused_in_one_sentence_that_names_a_frequency_that_works():
    with pytest.raises(PresetError) as refused:
        refuse_wrapping_depths(at(60e6, 120e6), {})
    said = str(refused.value)
    assert "60, 120 MHz can represent depths below 2.498 m" in said
    assert "up to 3.937 m from the camera" in said
    assert said.endswith("put a lower frequency first, at most 38 MHz")
    refuse_wrapping_depths(at(38e6, 60e6, 120e6), {})
    refuse_wrapping_depths(at(38e6), {})
    with pytest.raises(PresetError):
        refuse_wrapping_depths(at(38.1e6), {})  # 3.934 m


@pytest.mark.parametrize(
    ("frequencies_hz", "turns"), [((40e6, 70e6), 2), ((60e6, 80e6), 2), ((80e6, 100e6), 3), ((38e6, 70e6), 1)]
)
def test_what_the_first_frequency_does_not_represent_the_set_may(frequencies_hz, turns):
    preset = at(*frequencies_hz)
    refuse_wrapping_depths(preset, {})  # unambiguous together over 7.49 m or more
    assert combined_range_m(frequencies_hz) > largest_mirrored_depth_m(preset)
    assert turns_of_first_phase(preset) == turns
    first_m = unambiguous_range_m(frequencies_hz[0])
    assert (turns - 1) * first_m < largest_mirrored_depth_m(preset) < turns * first_m


def test_the_command_and_python_refuse_them_before_they_write_anything(tmp_path):
    preset = tmp_path / "fast.toml"
    preset.write_text("[itof]\nfrequencies_hz = [60e6, 120e6]\n")
    said = refusal("night-gen", "scenes", tmp_path / "data", "--preset", preset)
    assert "60, 120 MHz can represent depths below 2.498 m" in said
    with pytest.raises(PresetError, match="60, 120 MHz can represent"):
        make_dataset(tmp_path / "data", preset, progress=False)
    assert not (tmp_path / "data").exists()


def test_the_size_of_a_mesh_counts_as_it_is(tmp_path):
    trimesh.creation.icosphere(radius=3.0).export(tmp_path / "ball.ply")
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.ply")
    place = {axis: [1.3, 1.3] for axis in "xyz"}
    for name, radius_m in (("ball", 1.0), ("box", np.sqrt(3))):
        hidden = {"shapes": [f"mesh:{name}.ply"], "composite_fraction": 0, "location_m": place}
        preset = at(20e6, hidden_object=hidden | {"size_m": {"mesh": 2.0}})
        _, meshes = with_meshes(preset, tmp_path)
        centre_m = np.linalg.norm([1 + 1.3, 1 + 1.3, 1.65 - 1.3])  # of the camera's mirror image
        assert largest_mirrored_depth_m(preset, meshes) == pytest.approx(centre_m + radius_m, rel=1e-6)
        limit_hz = 299_792_458 / 2 / (centre_m + radius_m)
        refuse_wrapping_depths(at(0.999 * limit_hz, hidden_object=hidden | {"size_m": {"mesh": 2.0}}), meshes)
        with pytest.raises(PresetError):
            refuse_wrapping_depths(at(limit_hz, hidden_object=hidden | {"size_m": {"mesh": 2.0}}), meshes)


def test_an_object_on_a_path_of_its_own_is_as_deep_as_its_path():
    path_m = [[1.0, 0.7, 1.6], [1.1, 0.9, 1.6]]
    far = {"shape": "cube", "path_m": [[1.0, 2.9, 1.6], [1.1, 2.5, 1.6]]}
    dataset = {"frame_rate_hz": 5}
    both = [{"shape": "sphere", "path_m": path_m, "beside": [far]}]
    alone = largest_mirrored_depth_m(at(20e6, dataset=dataset, object=[far]))
    assert largest_mirrored_depth_m(at(20e6, dataset=dataset, object=both)) == alone
