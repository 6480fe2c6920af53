"""The baseline that predicts depth directly: readout, loss, and the way from training to ONNX."""

import json

import numpy as np
import pytest
import torch
from night_commands import night_here, refusal
from training_runs import FLIP, config_of, settings

from disk import PresetError
from itof import DepthMap, phasor_of_return
from itof.metrics import image_metrics, no_object_metrics, summarise
from model.network.readout import Readout
from model.paper.loss import NightLoss
from model.prediction.predictor import load
from model.run_folder.run_config import RunError
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")
DIRECT = Readout(20e6, target="depth", mask_from="depth")
COURSE = FLIP | {"target": "depth", "mask_depth_m": 1.0, "width": 8, "batch_size": 2, "learning_rate": 2e-3}


@pytest.fixture(scope="module")
def direct_run(closed_form_scenes, tmp_path_factory):
    run = tmp_path_factory.mktemp("direct") / "run"
    train(closed_form_scenes, run, settings(**COURSE | {"max_epochs": 12}))
    return run


def test_depth_mask_and_phasor_of_a_hand_made_output():
    output = torch.tensor([[[[-1.0, 0.0, 0.049], [0.051, 3.0, 9.0]]]])  # (1, 1, 2, 3)
    depth_m, mask = DIRECT.radial_depth_m(output), DIRECT.mask(output)
    expected_m = torch.tensor([[[0, 0, 0], [0.051, 3, 9]]])
    assert torch.equal(depth_m, expected_m)
    assert torch.equal(mask, (expected_m > 0).float())
    phasor = DIRECT.components(output)  # also beyond the unambiguous range of 7.5 m, where the phase wraps
    truth = np.where(mask > 0, phasor_of_return(expected_m.double().numpy(), 20e6), 0)
    np.testing.assert_allclose(phasor[:, 0] + 1j * phasor[:, 1], truth, atol=1e-6)
    far = Readout(20e6, target="depth", mask_from="depth", mask_depth_m=2.0, dead_zone=0.0)
    assert torch.equal(far.radial_depth_m(output), torch.tensor([[[0.0, 0, 0], [0, 3, 9]]]))
    assert (DIRECT.rule, far.rule) == ("depth above 0.05 m", "depth above 2 m")


def test_reading_the_phasor_again_gives_the_depth_and_the_mask_again():
    output = torch.linspace(-1, 7, 60).reshape(1, 1, 6, 10)
    again = DIRECT.of_phasors
    phasor = DIRECT.components(output)
    assert torch.equal(again.mask(phasor), DIRECT.mask(output))
    # float32: a phase of up to 2 pi, rounded to 2^-22, is 0.6 micrometres; a few roundings
    torch.testing.assert_close(again.radial_depth_m(phasor), DIRECT.radial_depth_m(output), atol=5e-6, rtol=0)
    assert Readout(20e6).of_phasors == Readout(20e6)


def test_the_loss_of_a_hand_made_depth_and_its_gradient():
    # Four pixels: a hit 0.5 m too near, a missed object pixel, false object at 1 m, right background.
    output = torch.tensor([[[[2.5, -0.2, 1.0, 0.01]]]], requires_grad=True)
    truth_m = torch.tensor([[[3.0, 2.0, 0.0, 0.0]]])
    mask = (truth_m > 0).float()
    loss = NightLoss(DIRECT, "mae+iou", "components", alpha=0.5, balance="image")
    # w = 0.5 * 2 / 2; both sums over 4 pixels; the IoU is 1 / 3.
    mae = 0.5 * (0.5 + 2.0) / 4 + 1.0 / 4
    value = loss(output, torch.zeros(1, 2, 1, 4), truth_m, mask)
    assert value.item() == pytest.approx((mae + 1 - 1 / 3) / 2, rel=1e-6)
    value.backward()
    # Of 1 - I/U with I = 1, U = 3, in the missed pixel (p = 0, truth 1): -1 / U; in the false one (p = 1,
    # truth 0): I / U^2; none where the mask is right. Of the MAE: sign times weight.
    expected = [-0.5 / 4, -0.5 / 4 - 1 / 3, 1 / 4 + 1 / 9, 1 / 4 * 0]
    found = 2 * output.grad[0, 0, 0]
    torch.testing.assert_close(found, torch.tensor(expected), rtol=1e-6, atol=1e-7)


def test_a_trained_baseline_beats_no_object_in_overlap(direct_run, shards):
    predictor = load(direct_run, "cpu")
    assert predictor.network.head[-1].out_channels == 1
    block = shards.read(shards.rows("train"))
    found = predictor.predict(block.phasors, shards.reference)
    images = zip(found.radial_depth_m, found.mask, block.radial_depth_m, block.mask, strict=True)
    own = summarise([image_metrics(*image) for image in images])
    empty = summarise([no_object_metrics(*p) for p in zip(block.radial_depth_m, block.mask, strict=True)])
    assert own.miou.mean > empty.miou.mean
    assert np.array_equal(found.mask, found.radial_depth_m > 1.0)
    assert np.abs(found.phasor[found.mask]) == pytest.approx(1, abs=1e-6)


@pytest.mark.long
def test_the_commands_take_a_baseline(direct_run, closed_form_scenes, exr, tmp_path, shards):
    import onnxruntime

    judge = (
        "night-eval",
        direct_run,
        closed_form_scenes.root,
        "--out",
        tmp_path / "report",
        "--device",
        "cpu",
    )
    done = night_here(*judge, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert (report["mask_from"], report["mask_threshold"]) == ("depth", None)
    assert "best_on_validation" not in json.dumps(report)
    page = (tmp_path / "report" / "index.html").read_text()
    assert "there is no threshold to choose" in page
    assert "The highest mIoU on the validation split" not in page
    for given in (("--mask-from", "amplitude"), ("--mask-threshold", 0.4)):
        assert "predicts depth and no amplitude" in refusal(*judge, *given)

    done = night_here("night-eval", "predict", direct_run, exr, "--out", tmp_path / "maps", "--force")
    assert done.returncode == 0, done.stderr
    (file,) = (tmp_path / "maps").glob("*.exr")
    written = DepthMap.read(file)
    predictor = load(direct_run, "cpu")
    expected = predictor.predict(shards.read([0]).phasors)[0]
    np.testing.assert_allclose(written.radial_depth_m, expected.radial_depth_m, atol=1e-5)
    assert np.array_equal(written.mask, expected.mask)

    model = tmp_path / "model.onnx"
    done = night_here("night-eval", "export", direct_run, "--out", model)
    assert done.returncode == 0, done.stderr
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    channels = predictor.config.inputs.apply(shards.read([0]).phasors, predictor.reference)
    (output,) = session.run(["radial_depth_m"], {"channels": channels})
    with torch.no_grad():
        ours = predictor.network(torch.from_numpy(channels))
    assert output.shape == (1, 1, *written.mask.shape)
    # float32: other kernels sum in another order, in twenty layers
    np.testing.assert_allclose(output, ours, atol=1e-4)


def test_what_contradicts_a_baseline_is_refused(direct_run, seeing_run, closed_form_scenes, tmp_path):
    with pytest.raises(PresetError, match=r"target\.loss must be 'mae', 'mse', 'mae\+iou' or 'mse\+iou'"):
        settings(target="depth", loss="mae+lovasz")
    with pytest.raises(ValueError, match="has no amplitude"):
        Readout(20e6, target="depth")
    with pytest.raises(RunError, match=r"target.kind is depth, but .* was trained with components"):
        train(closed_form_scenes, tmp_path / "run", settings(**COURSE), start_from=seeing_run)
    assert config_of(direct_run)["settings"]["target"]["kind"] == "depth"
