"""The network that predicts the mask and the depth: readout, loss, and the way from training to ONNX."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from night_commands import night_here
from synthetic_dataset import write_synthetic_dataset
from torch.nn import functional
from training_runs import FLIP, config_of, edit_config, settings

from itof import phasor_of_return, read_image, write_image
from itof.metrics import image_metrics, no_object_metrics, summarise
from model.data.object_depth import LEAST_SPREAD_M, BalanceError, object_depth_m
from model.data.rows import RowBlock
from model.network.loss import MaskAndDepthLoss
from model.network.mask_and_depth import MaskAndDepth
from model.prediction.predictor import load
from model.run_folder.run_config import RunError, read_config
from model.training.loop import train
from model.training.refusals import TrainingError

pytestmark = pytest.mark.usefixtures("one_thread")
READOUT = MaskAndDepth(20e6, depth_mean_m=3.0, depth_spread_m=0.5)
COURSE = FLIP | {"target": "mask+depth", "width": 8, "batch_size": 2}
COURSE |= {"learning_rate": 2e-3, "average_flip": True, "mask_threshold": 0.2, "block": 2}


@pytest.fixture(scope="module")
def run(closed_form_scenes, tmp_path_factory):
    out = tmp_path_factory.mktemp("both") / "run"
    train(closed_form_scenes, out, settings(**COURSE | {"max_epochs": 40}))
    return out


def test_mask_depth_and_phasor_of_a_hand_made_output():
    logits, depths = [-20.0, -0.1, 0.1, 20.0], [0.0, 1.0, 1.0, -2.0]
    output = torch.tensor([logits, depths]).reshape(1, 2, 1, 4)
    assert READOUT.mask(output).flatten().tolist() == [0, 0, 1, 1]
    torch.testing.assert_close(READOUT.radial_depth_m(output).flatten(), torch.tensor([0, 0, 3.5, 2.0]))
    re, im = READOUT.components(output)[0]
    probability = 1 / (1 + np.exp(-np.array(logits)))
    truth = probability * phasor_of_return(3.0 + 0.5 * np.array(depths), 20e6)
    np.testing.assert_allclose((re + 1j * im)[0], truth, atol=1e-6)
    assert READOUT.rule == "mask threshold 0.5"
    assert READOUT.output_channels == 2


def test_reading_the_phasor_again_gives_mask_and_depth_again():
    output = torch.stack([torch.linspace(-5, 5, 60), torch.linspace(-9, 9, 60)]).reshape(1, 2, 6, 10)
    again, phasor = READOUT.of_phasors, READOUT.components(output)
    assert torch.equal(again.mask(phasor), READOUT.mask(output))
    # float32: phases rounded to 2^-22 are within a micrometre; a few roundings
    torch.testing.assert_close(
        again.radial_depth_m(phasor), READOUT.radial_depth_m(output), atol=5e-6, rtol=0
    )


@pytest.mark.parametrize(
    ("beta", "depth"), [(1.0, (0.5 * 0.5**2 + (2.0 - 0.5)) / 2), (0.1, (0.45 + 1.95) / 2), (0.0, 1.25)]
)
def test_the_loss_of_a_hand_made_output_and_where_it_has_no_gradient(beta, depth):
    output = torch.tensor([[[[2.0, -1.0, 0.5]], [[0.5, 3.0, 8.0]]]], requires_grad=True)  # (1, 2, 1, 3)
    mask, truth_m = torch.tensor([[[1.0, 1.0, 0.0]]]), torch.tensor([[[3.0, 3.5, 0.0]]])
    value = MaskAndDepthLoss(READOUT, beta)(output, torch.zeros(1, 2, 1, 3), truth_m, mask)
    p = 1 / (1 + np.exp(-np.array([2.0, -1.0, 0.5])))
    entropy = -(np.log(p[0]) + np.log(p[1]) + np.log(1 - p[2])) / 3
    overlap = (p[0] + p[1]) / (2 + p[2])  # sum p m over sum p + m - p m
    assert value.item() == pytest.approx(entropy + 1 - overlap + depth, rel=1e-5)
    value.backward()
    assert output.grad[0, 1, 0, 2] == 0  # depth of the background
    assert (output.grad[0, 0, 0].sign() == torch.tensor([-1.0, -1.0, 1.0])).all()


def test_pixels_that_are_certainly_right_have_no_gradient_and_wrong_ones_keep_theirs():
    logit = torch.linspace(-320, 320, 65)
    for value, right in ((0.0, logit < -40), (1.0, logit > 40)):
        output = torch.stack([logit, torch.zeros(65)])[None, :, None].requires_grad_()  # (1, 2, 1, 65)
        mask = torch.full((1, 1, 65), value)
        truth_m = READOUT.depth_mean_m * mask
        loss = MaskAndDepthLoss(READOUT)(output, torch.zeros(1, 2, 1, 65), truth_m, mask)
        loss.backward()
        moved = output.grad[0, 0, 0]
        assert not moved[right].any()
        wrong = logit * (1 - 2 * value) >= 40
        torch.testing.assert_close(moved[wrong].abs(), torch.full((int(wrong.sum()),), 1 / 65))
        assert moved[moved != 0].abs().min() > 1e-30  # far from the smallest normal number, 1.2e-38
        p = logit.double().sigmoid()
        overlap = p.mean() if value else 0.0
        entropy = functional.softplus(logit.double() * (1 - 2 * value)).mean()
        assert loss.item() == pytest.approx(float(entropy + 1 - overlap), rel=1e-6)


def test_images_without_object_and_without_background_have_a_finite_loss():
    for value in (0.0, 1.0):
        output = torch.zeros(2, 2, 3, 4, requires_grad=True)
        mask = torch.full((2, 3, 4), value)
        MaskAndDepthLoss(READOUT)(output, torch.zeros(2, 2, 3, 4), 3 * mask, mask).backward()
        assert output.grad.isfinite().all()
        assert (output.grad[:, 0].sign() == (-1.0 if value else 1.0)).all()


def test_the_constants_of_the_depth_are_those_of_the_training_scenes(run, shards):
    block = shards.read(shards.rows("train"))
    depth_m = block.radial_depth_m[block.mask > 0].astype(np.float64)
    found = read_config(run).object_depth_m
    np.testing.assert_allclose(found, (depth_m.mean(), depth_m.std()), rtol=1e-9)
    assert found == object_depth_m(shards, shards.rows("train"))


def test_a_trained_network_beats_no_object_and_averages_mirror_images(run, shards):
    predictor, block = load(run, "cpu"), shards.read(shards.rows("train"))
    found = predictor.predict(block.phasors)
    images = zip(found.radial_depth_m, found.mask, block.radial_depth_m, block.mask, strict=True)
    own = summarise([image_metrics(*image) for image in images])
    empty = summarise([no_object_metrics(*p) for p in zip(block.radial_depth_m, block.mask, strict=True)])
    assert own.miou.mean > empty.miou.mean
    np.testing.assert_allclose(np.abs(found.phasor) >= 0.2, found.mask)
    # The wall of these scenes is symmetric about the camera's height.
    upside_down = predictor.predict(block.phasors[:, ::-1]).phasor[:, ::-1]
    np.testing.assert_allclose(upside_down, found.phasor, atol=1e-4)


@pytest.mark.long
def test_the_commands_take_such_a_run(run, closed_form_scenes, tmp_path, shards):
    import onnxruntime

    judge = ("night-eval", run, closed_form_scenes.root, "--device", "cpu", "--json")
    done = night_here(*judge, "--out", tmp_path / "report")
    assert done.returncode == 0, done.stderr
    plain = json.loads(done.stdout)
    done = night_here(*judge, "--out", tmp_path / "other", "--mask-threshold", 0.1)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["prediction"] != plain["prediction"]
    model = tmp_path / "model.onnx"
    done = night_here("night-eval", "export", run, "--out", model)
    assert done.returncode == 0, done.stderr
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    predictor = load(run, "cpu")
    channels = predictor.config.inputs.apply(shards.read([0]).phasors, predictor.reference)
    (output,) = session.run(["logit_and_depth"], {"channels": channels})
    with torch.no_grad():
        # float32: other kernels sum in another order, in twenty layers
        np.testing.assert_allclose(output, predictor.network(torch.from_numpy(channels)), atol=1e-4)


def test_a_run_that_lost_the_depth_of_its_objects_is_refused(run, tmp_path):
    assert config_of(run)["object_depth_m"]
    edit_config(run, object_depth_m=None)
    with pytest.raises(RunError, match=r"needs object_depth_m"):
        load(run, "cpu")


def test_scenes_of_one_depth_have_a_spread_and_scenes_without_object_are_refused(tmp_path):
    flat = RowBlock(
        (0,), np.zeros((1, 2, 2, 3)), np.zeros((1, 2, 2, 3)), np.full((1, 2, 3), 2.5), np.ones((1, 2, 3))
    )
    empty = replace(flat, radial_depth_m=0 * flat.radial_depth_m, mask=0 * flat.mask)
    for block, found in ((flat, (2.5, LEAST_SPREAD_M)), (empty, None)):
        shards = SimpleNamespace(manifest=SimpleNamespace(scenes_per_piece=1), read=lambda _, b=block: b)
        if found:
            assert object_depth_m(shards, [0]) == pytest.approx(found)
        else:
            with pytest.raises(BalanceError, match="shows no object: train with --preset known-wall"):
                object_depth_m(shards, [0])


def test_a_ground_truth_in_millimetres_is_refused(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=8)
    for scene in dataset.ids():
        file = dataset.render_folder(scene) / "mirrored.exr"
        image = read_image(file)
        write_image(file, {**image.channels, "depth.R": 1000 * image.channels["depth.R"]}, {})
    with pytest.raises(TrainingError, match="is the ground truth in millimetres"):
        train(dataset, tmp_path / "run", settings(**COURSE))
