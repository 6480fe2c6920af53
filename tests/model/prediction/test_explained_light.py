"""How much of the hidden light a depth map explains, against rendered scenes."""

import numpy as np
import pytest
from wall_measurements import expected_wall_of, noise, phasors_of

from itof import DepthMap
from model.prediction.explained_light import ExplainedLight, explained_light
from model.prediction.predictor import load
from model.prediction.surface_light import surface_light
from scenegen import open_dataset

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def scenes(seven_renders):
    """Channels of a shipped network, the wall, and phasors and true depth map of seven rendered scenes."""
    dataset = open_dataset(seven_renders)
    images = [
        (phasors_of(dataset, each), DepthMap.read(dataset.render_folder(each) / "mirrored.exr"))
        for each in dataset.ids()
    ]
    return load("night-40x30", "cpu").config.inputs, expected_wall_of(dataset), images


def test_the_truth_explains_the_light_of_a_scene_and_no_other_scene_does(scenes):
    inputs, wall, images = scenes
    others = [truth for _, truth in images[1:]] + [images[0][1]]
    for (z, truth), other in zip(images, others, strict=True):
        light = explained_light(inputs, z, wall, truth)
        # Nine pixels do not show how a sheet is bent.
        assert light.share > (0.6 if truth.mask.sum() < 10 else 0.9)
        assert not list(light.findings(shows_object=True))
        assert 1e-4 < light.strength < 2e-2
        again = explained_light(inputs, 7e3 * z, wall, truth)
        assert again.share == pytest.approx(light.share, rel=1e-5)  # float32
        assert explained_light(inputs, z, wall, other).share < light.share


def test_light_of_two_scenes_at_different_frequencies_is_not_explained(scenes):
    inputs, wall, images = scenes
    (one, truth), (other, _) = images[:2]
    mixed = np.concatenate([other[..., :1], one[..., 1:]], axis=-1)
    # No derivation: nothing says how much the light of two objects has in common. The truth explains more.
    assert explained_light(inputs, mixed, wall, truth).share < 0.5


def test_a_part_of_another_scene_is_named_and_one_scene_has_none(scenes):
    """Of renders, and of the light of two surfaces on the same wall, which differ in nothing else."""
    inputs, wall, images = scenes
    assert not any(explained_light(inputs, z, wall, one, thorough=True).other_scene for z, one in images)
    truths = [truth for _, truth in images[:2]]
    lights = [surface_light(np.float64(each.radial_depth_m), each.mask, wall) for each in truths]
    largest = np.abs(wall.direct).max()
    alike = [wall.direct + 2e-3 * largest / np.abs(light).max() * light for light in lights]
    for one, other in ([z for z, _ in images[:2]], alike):
        half = one.shape[1] // 2
        mixtures = {
            "": one,
            "the light at 20 MHz is not": np.concatenate([other[..., :1], one[..., 1:]], axis=-1),
            "the light at 60 MHz is not": np.concatenate([one[..., :2], other[..., 2:]], axis=-1),
            "the left and the right": np.concatenate([other[:, :half], one[:, half:]], axis=1),
        }
        for words, z in mixtures.items():
            told = explained_light(inputs, z, wall, truths[0], thorough=True).other_scene
            assert words in told
            assert bool(words) == bool(told)


def test_a_part_of_an_alike_scene_is_named_though_its_light_is_weak_and_nearly_explained():
    """Two parallel plates whose light is a fifth of a per mille of the wall's, in the corner of a network."""
    network = load("night-40x30", "cpu")
    inputs, wall = network.config.inputs, network.wall
    rows, columns = np.mgrid[:30, :40]
    places = (np.hypot(rows - 15, columns - 22) < 5, 1.0), (np.hypot(rows - 13, columns - 17) < 5, 1.2)
    plates = [
        DepthMap.of_object(np.where(mask, wall.radial_depth_m + behind_m, 0), mask, 20e6)
        for mask, behind_m in places
    ]
    lights = [surface_light(np.float64(each.radial_depth_m), each.mask, wall) for each in plates]
    weak = 3e-4 * np.abs(wall.direct).max()
    one, other = (wall.direct + weak / np.abs(light).max() * light for light in lights)
    mixtures = {
        "": one,
        "the light at 20 MHz is not": np.concatenate([other[..., :1], one[..., 1:]], axis=-1),
        "the light at 60 MHz is not": np.concatenate([one[..., :2], other[..., 2:]], axis=-1),
        "the left and the right": np.concatenate([other[:, :20], one[:, 20:]], axis=1),
    }
    for words, z in mixtures.items():
        light = explained_light(inputs, z, wall, plates[0], thorough=True)
        assert light.share > 0.8  # so that nothing else is told
        assert words in light.other_scene
        assert bool(words) == bool(light.other_scene)


def test_without_an_object_nothing_is_explained_and_noise_is_no_light(scenes):
    inputs, wall, images = scenes
    z, truth = images[0]
    nothing = DepthMap.of_object(0 * truth.radial_depth_m, np.zeros_like(truth.mask), 20e6)
    light = explained_light(inputs, z, wall, nothing)
    assert light.share == 0
    assert light.strength > 1e-4
    assert [each.refused for each in light.findings(shows_object=False)] == [False]
    assert [each.refused for each in light.findings(shows_object=True)] == [True]
    grain = noise(z.shape)
    for prediction in (nothing, truth):
        light = explained_light(inputs, wall.direct * (1 + 3e-3 * grain), wall, prediction)
        assert light.share is None
        assert 1e-4 < light.hideable < 3e-3  # less than the noise of a pixel, as the fit has many
        codes = [each.refused for each in light.findings(shows_object=prediction is truth)]
        assert codes == ([False] if prediction is truth else [])
    noisy = explained_light(inputs, z * (1 + 1e-4 * grain), wall, truth)
    # Noise of 1.4e-4 beside light of 4.4e-3 has 0.1 % of its power; twice that.
    assert noisy.share == pytest.approx(explained_light(inputs, z, wall, truth).share, abs=0.002)


@pytest.mark.parametrize(
    ("shows_object", "share", "refused"), [(True, 0.0, True), (True, 0.5, False), (False, 0.0, False)]
)
def test_far_too_much_light_is_told_and_an_object_that_explains_none_of_it_is_refused(
    shows_object, share, refused
):
    (finding,) = ExplainedLight(0.05, 1e-5, 1e-5, share).findings(shows_object=shows_object)
    assert finding.sentence.startswith("what is not the wall's light is 50 per mille of the direct light")
    assert finding.refused is refused
