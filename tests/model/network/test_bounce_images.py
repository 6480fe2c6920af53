"""The images of the hidden scene that a linear inverse of the three bounces makes for a network."""

import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from night_commands import night_here
from safetensors.torch import load_file
from synthetic_dataset import write_synthetic_dataset
from training_runs import assert_same_end, settings, train_on_one_thread

from disk import PresetError
from itof import pixel_rays
from model.data.corner import wall_view
from model.data.object_depth import object_depth_m
from model.data.shards import open_shards
from model.network.bounce_images import PLANES, BounceImages, _means
from model.network.channels import InputSpec
from model.network.unet import UNet
from model.prediction.predictor import load
from model.refinement.light.corner_light import CornerLight, Mirror, known_corner, vector
from model.refinement.light.inverse import SPREADS, bounce_inverse
from model.run_folder.run_config import RunError
from model.training.loop import train
from model.training.refusals import TrainingError
from render.backend import BackendError
from scenegen import open_dataset
from scenegen.scene import HiddenObject

pytestmark = pytest.mark.usefixtures("one_thread")
HZ = (20e6, 50e6, 60e6)
INPUTS = InputSpec("residual", HZ, 1.0, (1e-3,) * 5, "measured", "self")
MEAN_M, SPREAD_M = 2.7, 0.2
WIDTH, HEIGHT = 40, 30
SHOWN = {"channels": "residual", "reference": "self", "bounce_images": True}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=8)


@pytest.fixture(scope="module")
def images(dataset):
    """The images of the paper's corner."""
    found = BounceImages(*INPUTS.residual_channels, WIDTH, HEIGHT)
    corner = known_corner(dataset.scene(dataset.ids()[0])), wall_view(dataset)
    found.load_state_dict(bounce_inverse(found, *corner, INPUTS, (MEAN_M, SPREAD_M)))
    return found


@pytest.fixture(scope="module")
def begun(dataset, tmp_path_factory):
    """Run folder of one epoch of a network with images; for reading only."""
    return train_on_one_thread(dataset, tmp_path_factory.mktemp("begun") / "run", **SHOWN | {"max_epochs": 1})


def channels_of(dataset, pixel, depth_m, width=WIDTH, height=HEIGHT, size_m=0.2):
    """(1, C, H, W) input channels of a sphere whose mirror image is in the middle of a pixel (x, y)."""
    corner, view = known_corner(dataset.scene(dataset.ids()[0])), wall_view(dataset)
    direct = view.direct_phasors(width, height, HZ)
    wall = view.expected_wall(direct, HZ)
    towards = pixel_rays(WIDTH, HEIGHT, view.horizontal_fov_deg)[pixel[1], pixel[0]]
    place = Mirror(corner.camera, wall.plane_per_m).points_m(np.array(depth_m), towards)
    sphere = HiddenObject("sphere", (size_m,) * 3, vector(place), (0, 0, 0), 1.0)
    relay = replace(corner.relay_wall, roughness=0.4)
    scene = replace(corner, hidden_objects=(sphere,), relay_wall=relay)
    hidden = CornerLight(HZ).over_direct([scene], wall.rays.reshape(-1, 3), fine=True)
    phasor = direct * (1 + hidden.reshape(direct.shape))
    found = INPUTS.apply(phasor, INPUTS.reference_of_image(phasor, wall), is_weighted=True)
    return torch.as_tensor(found, dtype=torch.float32)[None]


@pytest.mark.parametrize(("count", "pixels"), [(4, 12), (3, 7), (5, 5), (6, 4)])
def test_means_over_parts_of_an_axis_are_integrals_of_what_is_constant_on_each_pixel(count, pixels):
    values = np.random.default_rng(0).normal(size=pixels)
    whole = np.concatenate([[0.0], np.cumsum(values)])  # the integral from 0, linear between whole numbers
    edges = np.linspace(0, pixels, count + 1)
    expected = np.diff(np.interp(edges, np.arange(pixels + 1), whole)) * count / pixels
    found = _means(count, pixels, torch.zeros((), dtype=torch.float64)) @ torch.as_tensor(values)
    assert found.numpy() == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("pixel", [(14, 12), (20, 15), (24, 19)])
def test_the_image_of_a_sphere_is_brightest_where_its_mirror_image_is(dataset, images, pixel):
    mean = images(channels_of(dataset, pixel, MEAN_M))[0].sum(dim=0)  # over depths
    y, x = np.unravel_index(int(mean.argmax()), mean.shape)
    # A pixel of the coarse images is 2.5 pixels wide.
    assert max(abs(x - pixel[0]), abs(y - pixel[1])) <= 3


def test_a_sphere_at_each_depth_is_brighter_at_that_depth_than_one_elsewhere(dataset, images):
    depths = MEAN_M + SPREAD_M * np.array([-SPREADS, 0.0, SPREADS])
    seen = [images(channels_of(dataset, (20, 15), depth))[0] for depth in depths]
    share = torch.stack([each.clamp(min=0).sum(dim=(1, 2)) / each.clamp(min=0).sum() for each in seen])
    middles = share @ torch.arange(PLANES, dtype=torch.float32)  # the mean depth of what an image shows
    assert middles[0] < middles[1] < middles[2]


def test_images_are_linear_in_the_channels_and_flip_with_them(dataset, images):
    channels = channels_of(dataset, (16, 11), MEAN_M)
    once, thrice, flipped = images(channels), images(3 * channels), images(channels.flip(-2))
    # What is left is rounding of float32 sums.
    assert float((thrice / 3 - once).norm() / once.norm()) < 1e-5
    # The corner is level, so it looks the same upside down, but the points of a sphere do not.
    assert float((flipped.flip(-2) - once).norm() / once.norm()) < 0.01


def test_images_of_another_size_show_the_same(dataset, images):
    channels = channels_of(dataset, (20, 13), MEAN_M, 80, 60)
    halved = torch.nn.functional.avg_pool2d(channels, 2)
    coarse, expected = torch.nn.functional.avg_pool2d(images(channels), 2), images(halved)
    # Bilinear at four points, and its mean, are bilinear at the middle; the rest is rounding of float32.
    assert float((coarse - expected).norm() / expected.norm()) < 1e-5


def test_a_network_without_weights_for_the_images_is_the_network_without_them(images):
    plain = UNet(5, 4, block=2, generator=torch.Generator().manual_seed(0))
    shown = UNet(5, 4, block=2, images=images)
    weights = shown.state_dict() | plain.state_dict()
    first = "encoder.0.0.weight"
    weights[first] = torch.zeros_like(shown.state_dict()[first])
    weights[first][:, : 5 * 4] = plain.state_dict()[first]
    shown.load_state_dict(weights)
    channels = torch.randn(2, 5, 26, 34, generator=torch.Generator().manual_seed(1))
    assert torch.allclose(shown(channels), plain(channels), atol=1e-5)


def test_a_run_keeps_the_images_of_its_corner_and_goes_on_to_the_same_weights(dataset, begun, tmp_path):
    whole, parts = tmp_path / "whole", shutil.copytree(begun, tmp_path / "parts")
    train(dataset, whole, settings(**SHOWN))
    train(dataset, parts, settings(**SHOWN), resume=True)
    assert_same_end(whole, parts)
    assert torch.equal(
        load(whole).network.images.project, load_file(whole / "best.safetensors")["images.project"]
    )


def test_the_images_of_training_scenes_have_the_variance_1_and_the_inverse_is_the_same_each_time(
    dataset, begun
):
    predictor, shards, corner = load(begun), open_shards(dataset), wall_view(dataset)
    inputs, rows = predictor.config.inputs, shards.rows("train")
    phasor = shards.read(rows).phasors
    wall = corner.expected_wall(shards.reference, HZ)
    channels = inputs.apply(phasor, inputs.reference_of_image(phasor, wall), is_weighted=True)
    images = predictor.network.images
    assert float(images(torch.as_tensor(channels)).std()) == pytest.approx(1, rel=1e-4)  # float32
    bare = bounce_inverse(
        images, known_corner(dataset.scene(dataset.ids()[0])), corner, inputs, object_depth_m(shards, rows)
    )
    assert torch.equal(images.expand, bare["expand"])


@pytest.mark.long
def test_the_onnx_file_of_a_network_with_images_is_compared_with_torch_and_written(begun, tmp_path):
    done = night_here("night-eval", "export", begun, "--out", tmp_path / "model.onnx")
    assert done.returncode == 0, done.stderr  # it refuses a file that computes something else


@pytest.mark.long
def test_fine_tuning_in_another_shape_has_the_images_of_the_new_corner(dataset, tmp_path):
    tall = write_synthetic_dataset(tmp_path / "tall", count=8, width=16, height=24)
    train(dataset, tmp_path / "run", settings(**SHOWN))
    train(tall, tmp_path / "tuned", settings(**SHOWN, max_epochs=1), start_from=tmp_path / "run")
    found = load(tmp_path / "tuned").network.images
    assert found.shape == (24, 16)
    assert float(found.project.norm()) > 0


def test_images_need_residual_channels_and_one_corner(tmp_path):
    with pytest.raises(PresetError, match=r"bounce_images goes with .* residual or paper\+residual"):
        settings(channels="paper", bounce_images=True)
    many = write_synthetic_dataset(
        tmp_path / "many", count=8, camera_spread={"location_m": 0.1, "rotation_deg": 2.0}
    )
    with pytest.raises(TrainingError, match="bounce_images are for one corner"):
        train(many, tmp_path / "run", settings(**SHOWN))


def test_without_the_engine_a_training_with_images_is_refused_before_it_begins(
    dataset, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(
        TrainingError, match=r"\[render\]', or train .*: --set input.channels.bounce_images=false"
    ):
        train(dataset, tmp_path / "run", settings(**SHOWN))
    bare = settings(**SHOWN | {"bounce_images": False})
    with pytest.raises(BackendError, match=r"\[render\]'"):
        train(dataset, tmp_path / "run", bare, fresh=open_dataset(dataset.root).preset)
    assert not (tmp_path / "run").exists()


def test_a_run_with_images_cannot_be_resumed_or_started_from_without_them(dataset, begun, tmp_path):
    other = settings(**SHOWN | {"bounce_images": False})
    with pytest.raises(RunError, match="bounce_images"):
        train(dataset, begun, other, resume=True)
    with pytest.raises(RunError, match="bounce_images is False"):
        train(dataset, tmp_path / "new", replace(other), start_from=begun)
