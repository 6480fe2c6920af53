"""The expected error of the depth: its loss, its head, its fit, and the way into files and fine-tuning."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from night_commands import night_here, refusal
from safetensors.torch import load_file
from training_runs import FLIP, config_of, settings, train_on_one_thread

from itof import DepthMap, ImageFileError, depth_from_phase, read_image
from itof.exr.image import write_image
from model.data.shards import open_shards
from model.network.loss import MaskAndDepthLoss
from model.network.mask_and_depth import LARGEST_LOG_ERROR, MaskAndDepth
from model.network.unet import UNet
from model.prediction.predictor import load
from model.run_folder.history import read_history
from model.run_folder.run_config import RunError
from model.training.loop import train
from model.training.uncertainty_fit import UncertaintyFactors, UncertaintyFit

pytestmark = pytest.mark.usefixtures("one_thread")
READOUT = MaskAndDepth(20e6, depth_mean_m=3.0, depth_spread_m=0.5, has_uncertainty=True)
PLAIN = FLIP | {"target": "mask+depth", "width": 8, "batch_size": 2, "block": 2}
PLAIN |= {"learning_rate": 1e-3, "mask_threshold": 0.2, "clip_norm": 1.0, "max_epochs": 16}
PLAIN |= {"seed": 4}  # with which the head becomes over-confident in the last epochs
UNSURE = PLAIN | {"uncertainty": True}


@pytest.fixture(scope="module")
def plain_run(closed_form_scenes, tmp_path_factory):
    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("plain") / "run", **PLAIN)


@pytest.fixture(scope="module")
def unsure_run(closed_form_scenes, tmp_path_factory):
    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("unsure") / "run", **UNSURE)


def outputs(logit, depth, log_error):
    """(N, 3, 1, W) outputs from lists of the same shape (N, W)."""
    return torch.stack([torch.tensor(values) for values in (logit, depth, log_error)], dim=1)[:, :, None]


def test_the_expected_error_of_a_hand_made_output():
    output = outputs([[1.0, 1.0, 1.0]], [[0.0, 1.0, 2.0]], [[0.0, math.log(0.1), -1e9]])
    error_m = READOUT.depth_error_m(output)
    expected_m = torch.tensor([[[0.5, 0.05, 0.5 * math.exp(-LARGEST_LOG_ERROR)]]])
    torch.testing.assert_close(error_m, expected_m)
    largest = outputs([[1.0]], [[0.0]], [[1e9]])  # of a measurement unlike any of the training
    assert READOUT.depth_error_m(largest).item() == pytest.approx(7.495, abs=1e-3)  # c / 2f at 20 MHz
    assert replace(READOUT, has_uncertainty=False).depth_error_m(output) is None


def test_the_loss_is_lowest_where_the_expected_error_is_the_mean_error_and_moves_nothing_else():
    rng = torch.Generator().manual_seed(0)
    mask = (torch.rand(2, 6, 8, generator=rng) < 0.5).float()
    depth_m = mask * (2.5 + torch.rand(2, 6, 8, generator=rng))
    output = torch.randn(2, 3, 6, 8, generator=rng)
    error = (output[:, 1] - READOUT.standardised(depth_m)).abs()
    mean = ((error * mask).sum(dim=(1, 2)) / mask.sum(dim=(1, 2))).log()  # (N,)
    output[:, 2] = mean[:, None, None]
    output.requires_grad_()
    loss = MaskAndDepthLoss(READOUT)(output, torch.zeros(2, 2, 6, 8), depth_m, mask)
    loss.backward()
    torch.testing.assert_close(output.grad[:, 2].sum(dim=(1, 2)), torch.zeros(2), atol=1e-7, rtol=0)
    assert float(output.grad[:, 2].abs().max()) > 1e-3  # single pixels are not at their minimum
    assert not output.grad[:, 2][mask == 0].any()
    alone = output.detach().requires_grad_()
    rest = MaskAndDepthLoss(replace(READOUT, has_uncertainty=False))(
        alone, torch.zeros(2, 2, 6, 8), depth_m, mask
    )
    rest.backward()
    assert torch.equal(alone.grad[:, :2], output.grad[:, :2])
    # At the minimum the mean of |error| / b is 1.
    torch.testing.assert_close(loss - rest, 1 + mean.mean())


@pytest.mark.long
def test_the_head_finds_which_pixels_have_large_errors():
    """The target is noise of a size that the input says: the expected error is its mean absolute value."""
    rng = torch.Generator().manual_seed(1)
    network = UNet(1, 8, output_channels=2, uncertainty=True, generator=rng)
    adam = torch.optim.Adam(network.parameters(), lr=4e-3)
    loss = MaskAndDepthLoss(READOUT, beta=1.0)
    size, mask = (8, 12, 12), torch.ones(8, 12, 12)
    for step in range(500):
        # With a step size that falls to 0, the end does not depend on the last batches, or on the rounding of
        # a processor: other batches from the same weights gave ratios of 0.88 to 1.25.
        adam.param_groups[0]["lr"] = 4e-3 * (1 - step / 500)
        spread = torch.rand(8, 1, 1, generator=rng).expand(size)
        noise = 0.05 * (40.0**spread) * torch.randn(size, generator=rng)
        depth_m = READOUT.depth_mean_m + READOUT.depth_spread_m * noise
        value = loss(network(spread[:, None]), torch.zeros(8, 2, 12, 12), depth_m, mask)
        adam.zero_grad()
        value.backward()
        adam.step()
    spread = torch.linspace(0.1, 0.9, 8)
    with torch.no_grad():
        found_m = READOUT.depth_error_m(network(spread[:, None, None, None].expand(8, 1, 12, 12)))
    truth_m = READOUT.depth_spread_m * 0.05 * 40.0**spread * (2 / math.pi) ** 0.5
    ratio = found_m.mean(dim=(1, 2)) / truth_m
    assert ratio.min() > 0.6  # the ratios above, and as much again
    assert ratio.max() < 1.6
    assert truth_m.max() / truth_m.min() > 15


@pytest.mark.parametrize("block", [1, 2])
def test_a_network_with_uncertainty_begins_as_the_one_without(block):
    one, other = (
        UNet(3, 4, block=block, uncertainty=has, generator=torch.Generator().manual_seed(0))
        for has in (False, True)
    )
    for name, weight in one.state_dict().items():
        assert torch.equal(weight, other.state_dict()[name])
    image = torch.randn(2, 3, 20, 36, generator=torch.Generator().manual_seed(1))
    assert torch.equal(other(image)[:, :2], one(image))
    assert other(image).shape == (2, 3, 20, 36)
    first, second = other.independent_parts
    other(image)[:, 2].sum().backward()
    assert not any(weight.grad.any() for weight in first)
    assert all(weight.grad.any() for weight in second)
    assert len(one.independent_parts) == 1


def test_everything_else_is_trained_and_kept_as_without_uncertainty(plain_run, unsure_run):
    plain, unsure = (read_history(run) for run in (plain_run, unsure_run))
    losses = np.array(unsure["validation_loss"]) - np.array(unsure["validation_uncertainty"])
    np.testing.assert_allclose(losses, plain["validation_loss"], rtol=1e-9)
    assert not any(plain["validation_uncertainty"])
    assert np.argmin(unsure["validation_loss"]) != np.argmin(losses)  # which would keep another epoch
    one, other = (load_file(run / "best.safetensors") for run in (plain_run, unsure_run))
    assert all(torch.equal(weight, other[name]) for name, weight in one.items())
    assert {name.split(".")[0] for name in other.keys() - one.keys()} == {"uncertainty_head"}


def test_expected_errors_are_those_of_the_validation_scenes_on_average(
    unsure_run, closed_form_scenes, shards
):
    block = shards.read(shards.rows("validation"))
    found = load(unsure_run, "cpu").predict(block.phasors)
    on_object = block.mask > 0
    depth_m = depth_from_phase(np.angle(found.phasor) % (2 * np.pi), 20e6)  # also where no object is found
    actual_m = np.abs(depth_m - block.radial_depth_m)[on_object]
    assert np.mean(actual_m / found.depth_error_m[on_object]) == pytest.approx(1, rel=1e-3)
    assert found.depth_error_m.shape == found.mask.shape
    assert found.depth_error_m.dtype == np.float32


def test_factors_of_several_processes_and_batches_are_those_of_all_pixels():
    rng = torch.Generator().manual_seed(0)
    output = torch.randn(6, 3, 5, 7, generator=rng)
    mask = (torch.rand(6, 5, 7, generator=rng) < 0.5).float()
    depth_m = 3 * mask
    fits = [UncertaintyFit(READOUT, torch.device("cpu")) for _ in range(2)]
    for fit, part in zip(fits, (slice(0, 2), slice(2, 6)), strict=True):
        fit.add(output[part], depth_m[part], mask[part])
    fit = UncertaintyFit(READOUT, torch.device("cpu"))
    fit.add(output, depth_m, mask)
    shares = {}

    def keep(tensor):
        shares.setdefault(tensor.shape, []).append(tensor)
        return tensor

    for each in fits:
        each.result(keep)
    both = fits[0].result(lambda tensor: sum(shares[tensor.shape]))
    whole = fit.result(lambda tensor: tensor)
    assert both.error_factor == pytest.approx(whole.error_factor, rel=1e-12)
    assert both.logit_factor == pytest.approx(whole.logit_factor, rel=1e-9)
    ratio = output[:, 1].abs() / output[:, 2].exp()
    assert whole.error_factor == pytest.approx(float(ratio[mask > 0].double().mean()), rel=1e-6)
    nothing = UncertaintyFit(READOUT, torch.device("cpu"))
    nothing.add(output, depth_m, torch.zeros_like(mask))
    assert nothing.result(lambda tensor: tensor) == UncertaintyFactors(1.0, 1.0)


def test_a_trained_network_gets_a_head_for_its_errors(plain_run, closed_form_scenes, tmp_path):
    more = ("--set", "target.uncertainty=true", "--max-epochs", 1, "--batch-size", 4)
    done = night_here(
        *("night-train", closed_form_scenes.root, "--out", tmp_path / "run", "--from", plain_run, *more)
    )
    assert done.returncode == 0, done.stderr
    chosen = config_of(tmp_path / "run")["settings"]
    assert (chosen["target"]["uncertainty"], chosen["network"]["width"]) == (True, 8)
    z = open_shards(closed_form_scenes).read([0, 1]).phasors
    assert load(plain_run, "cpu").predict(z).depth_error_m is None
    assert (load(tmp_path / "run", "cpu").predict(z).depth_error_m > 0).all()


def test_an_uncertainty_goes_with_mask_and_depth_and_stays(unsure_run, closed_form_scenes, tmp_path):
    with pytest.raises(RunError, match=r"target.uncertainty is False, but .* was trained with True"):
        train(closed_form_scenes, tmp_path / "run", settings(**PLAIN), start_from=unsure_run)
    sentence = refusal("night-train", closed_form_scenes.root, "--out", tmp_path / "x", "--preset",
                       "known-wall", "--set", "target.uncertainty=true")  # fmt: skip
    assert "target.uncertainty goes with target.kind mask+depth, and it is components" in sentence


def test_a_prediction_has_the_expected_error_in_its_files(closed_form_scenes, plain_run, exr, tmp_path):
    """At two frequencies: the single path of these scenes does not explain three, which is a warning."""
    import json

    two = UNSURE | {"frequencies_hz": (20e6, 50e6)}
    unsure_run = train_on_one_thread(closed_form_scenes, tmp_path / "runs" / "two" / "run", **two)
    for run, has in ((unsure_run, True), (plain_run, False)):
        out = tmp_path / run.parent.name
        done = night_here("night-eval", "predict", run, exr, "--out", out, "--force")
        assert done.returncode == 0, done.stderr
        image = json.loads((out / "prediction.json").read_text())["images"][0]
        read = DepthMap.read(out / "000000.exr")
        assert ("depth_error.R" in read_image(out / "000000.exr").channels) == has
        if not has:
            assert read.depth_error_m is None
            assert image["expected_depth_error_m"] is None
            continue
        assert read.mask.any()
        assert image["expected_depth_error_m"] == pytest.approx(float(read.depth_error_m[read.mask].mean()))
        assert f"expected error of the depth {100 * image['expected_depth_error_m']:.1f} cm" in done.stdout


def test_a_depth_map_with_errors_survives_its_file_and_bad_errors_are_refused(tmp_path):
    depth_m = np.array([[0.0, 3.0]], np.float32)
    errors_m = np.array([[0.2, 0.01]], np.float32)
    known = replace(DepthMap.of_object(depth_m, depth_m > 0, 20e6), depth_error_m=errors_m)
    known.write(tmp_path / "a.exr", {})
    np.testing.assert_array_equal(DepthMap.read(tmp_path / "a.exr").depth_error_m, errors_m)
    for bad, words in ((-1.0, "no depth map"), (np.nan, "1 values that are NaN")):
        channels = known.channels() | {"depth_error.R": np.array([[bad, 0.1]], np.float32)}
        write_image(tmp_path / "b.exr", channels, {})
        with pytest.raises(ImageFileError, match=words):
            DepthMap.read(tmp_path / "b.exr")
    both = DepthMap(*(np.stack([v, v]) for v in (depth_m, depth_m > 0, known.phasor)), 20e6,
                    np.stack([errors_m, 2 * errors_m]))  # fmt: skip
    np.testing.assert_array_equal(both[1].depth_error_m, 2 * errors_m)


def test_run_ids_of_runs_without_uncertainty_stay_as_they_were(plain_run, unsure_run):
    assert config_of(plain_run)["run_id"] != config_of(unsure_run)["run_id"]
