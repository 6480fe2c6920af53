"""Loss and readout give the numbers computed by hand, and gradients that lead away from every bad output."""

import math

import numpy as np
import pytest
import torch

from itof import depth_from_phase, phase, phasor_of_return
from model.network.loss import NightLoss, intersection_over_union
from model.network.readout import Readout

READOUT = Readout(20e6)
HEIGHT, WIDTH = 2, 3


def truth(mask: torch.Tensor, depth_m: float = 3.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Target, depth and mask of an object at one depth."""
    phasor = complex(phasor_of_return(depth_m, 20e6))
    target = torch.stack([phasor.real * mask, phasor.imag * mask], dim=1)
    return target, depth_m * mask, mask


def one_object() -> torch.Tensor:
    """One image of 2 x 3 pixels, two of them object."""
    mask = torch.zeros(1, HEIGHT, WIDTH)
    mask[0, 0, :2] = 1
    return mask


def test_iou_of_hand_made_masks():
    gt = torch.tensor([[[1.0, 1, 0], [0, 0, 0]]] * 4)
    pred = torch.tensor(
        [[[1.0, 1, 0], [0, 0, 0]], [[0, 1, 1], [0, 0, 0]], [[0, 0, 1], [1, 1, 1]], [[0.0] * 3] * 2]
    )
    expected = torch.tensor([1.0, 1 / 3, 0.0, 0.0])
    torch.testing.assert_close(intersection_over_union(pred, gt), expected)
    empty = torch.zeros(1, 2, 3)
    assert float(intersection_over_union(empty, empty)) == 1.0


def test_a_perfect_prediction_costs_nothing():
    target, depth_m, mask = truth(one_object())
    for variant in ("components", "depth"):
        loss = NightLoss(READOUT, on=variant)(target, target, depth_m, mask)
        # float32 phase: 7.5 m * 6e-8 * a few operations
        assert float(loss) == pytest.approx(0, abs=2e-6)


def test_the_components_loss_of_a_hand_made_prediction():
    target, depth_m, mask = truth(one_object())
    output = target.clone()
    output[0, :, 0, 0] = 0  # a missed object pixel: |Re| + |Im| of the target, halved
    output[0, :, 1, 2] = torch.tensor([0.6, -0.8])  # a false object pixel of amplitude 1
    missed = float(target[0, :, 0, 0].abs().sum()) / 2
    weight = (1 / 7) * 4 / 2  # alpha |B| / |O|
    mean_absolute = weight * missed / 6 + 0.7 / 6  # sums over object and background, over all six pixels
    iou = 1 / 3  # one of the three pixels in the union
    loss = NightLoss(READOUT)(output, target, depth_m, mask)
    assert float(loss) == pytest.approx((mean_absolute + 1 - iou) / 2, rel=1e-6)


def test_the_depth_loss_of_a_hand_made_prediction():
    target, depth_m, mask = truth(one_object(), 3.0)
    output = target.clone()
    nearer = complex(phasor_of_return(2.5, 20e6))
    output[0, :, 0, 0] = torch.tensor([nearer.real, nearer.imag])  # half a metre off
    output[0, :, 0, 1] = 0  # missed: the whole 3 m
    weight = (1 / 7) * 4 / 2
    loss = NightLoss(READOUT, on="depth")(output, target, depth_m, mask)
    assert float(loss) == pytest.approx((weight * (0.5 + 3.0) / 6 + 1 - 1 / 2) / 2, rel=1e-5)


@pytest.mark.parametrize("on", ["components", "depth"])
def test_the_ablations_of_a_hand_made_prediction(on):
    target, depth_m, mask = truth(one_object(), 3.0)
    output = target.clone()
    output[0, :, 0, 1] = 0  # missed
    output[0, :, 1, 2] = torch.tensor([0.6, -0.8])  # false, at 7.5 m (1 - 0.9273 / 2 pi)
    false_m = float(depth_from_phase(phase(0.6 - 0.8j), 20e6))
    missed, false = (
        ([float(x) for x in target[0, :, 0, 1].abs()], [0.6, 0.8])
        if on == "components"
        else (
            [3.0],
            [false_m],
        )
    )
    weight = (1 / 7) * 4 / 2  # alpha |B| / |O|

    def error(power: int) -> float:
        on_object, on_background = (np.mean([x**power for x in part]) for part in (missed, false))
        return (weight * on_object + on_background) / 6

    no_overlap = 1 - 1 / 3  # one of the three pixels in the union
    expected = {
        "mae": error(1),
        "mse": error(2),
        "mae+iou": (error(1) + no_overlap) / 2,
        "mse+iou": (error(2) + no_overlap) / 2,
    }
    found = {name: float(NightLoss(READOUT, name, on)(output, target, depth_m, mask)) for name in expected}
    assert found == pytest.approx(expected, rel=1e-5)


def test_an_image_without_object_costs_only_its_false_pixels():
    target, depth_m, mask = truth(torch.zeros(1, HEIGHT, WIDTH))
    output = torch.zeros_like(target)
    loss = NightLoss(READOUT)
    assert float(loss(output, target, depth_m, mask)) == 0
    output[0, :, 0, 0] = torch.tensor([1.0, 0.0])
    assert float(loss(output, target, depth_m, mask)) == pytest.approx((0.5 / 6 + 1) / 2)


def test_the_loss_of_a_batch_is_the_mean_of_its_images():
    masks = torch.cat([one_object(), torch.zeros(1, HEIGHT, WIDTH)])
    target, depth_m, mask = truth(masks)
    output = torch.randn(2, 2, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(1))
    loss = NightLoss(READOUT)
    each = [loss(output[i : i + 1], target[i : i + 1], depth_m[i : i + 1], mask[i : i + 1]) for i in range(2)]
    torch.testing.assert_close(loss(output, target, depth_m, mask), sum(each) / 2)


@pytest.mark.parametrize("variant", ["components", "depth"])
def test_descent_leaves_the_prediction_of_nothing_and_finds_the_object(variant):
    target, depth_m, mask = truth(one_object().repeat(2, 1, 1))
    output = 1e-3 * torch.randn(target.shape, generator=torch.Generator().manual_seed(2))
    output[0] = 0  # one image is exactly 0, the other nearly
    loss = NightLoss(READOUT, on=variant)
    output.requires_grad_()
    step = 0.5
    for _ in range(1200):
        (gradient,) = torch.autograd.grad(loss(output, target, depth_m, mask), output)
        output.data -= step * gradient
    predicted = output.detach()
    assert torch.equal(READOUT.mask(predicted), mask)
    # The last steps go back and forth across the truth: step * (alpha |B| / |O|) / 6 pixels / 2 terms /
    # 2 images times the error's slope of at most 1.2 m / rad is below 0.02 in phase, 2.4 cm.
    assert (READOUT.radial_depth_m(predicted) - depth_m).abs().max() < 0.024


def test_gradients_stay_finite_everywhere_and_stop_beyond_the_amplitude_of_the_truth():
    target, depth_m, mask = truth(one_object())
    for variant in ("components", "depth"):
        for scale in (0.0, 1e-20, 0.04, 1.0, 1e6):
            output = (scale * torch.ones_like(target)).requires_grad_()
            NightLoss(READOUT, on=variant)(output, target, depth_m, mask).backward()
            assert torch.isfinite(output.grad).all()
    output = (3 * target).requires_grad_()
    intersection_over_union(READOUT.mask(output), mask).sum().backward()
    assert torch.count_nonzero(output.grad[mask[:, None].expand_as(target) > 0]) == 0


def test_the_mask_is_hard_forward_and_has_the_gradient_of_the_amplitude_backward():
    output = torch.tensor(
        [[[[0.3, 0.06]], [[0.4, 0.08]]]], requires_grad=True
    )  # (1, 2, 1, 2), amplitudes .5, .1
    mask = READOUT.mask(output)
    assert mask.tolist() == [[[1.0, 0.0]]]
    mask.sum().backward()
    torch.testing.assert_close(output.grad, torch.tensor([[[[0.6, 0.6]], [[0.8, 0.8]]]]))


def test_small_components_are_zeroed_forward_and_passed_backward():
    output = torch.tensor([[[[0.049, -0.051]], [[-0.049, 0.9]]]], requires_grad=True)
    components = READOUT.components(output)
    torch.testing.assert_close(components, torch.tensor([[[[0.0, -0.051]], [[0.0, 0.9]]]]))
    components.sum().backward()
    assert torch.equal(output.grad, torch.ones_like(output))
    assert torch.equal(Readout(20e6, dead_zone=0.0).components(output), output)


def test_depth_is_that_of_itof_over_the_whole_range_and_zero_off_the_mask():
    depth_m = np.linspace(0.1, 7.4, 40)
    z = phasor_of_return(depth_m, 20e6)
    output = torch.from_numpy(np.stack([z.real, z.imag])[None, :, None])  # (1, 2, 1, 40)
    readout = Readout(20e6, dead_zone=0.0)
    np.testing.assert_allclose(readout.radial_depth_m(output)[0, 0], depth_m, rtol=1e-12)
    np.testing.assert_allclose(depth_m, depth_from_phase(phase(z), 20e6), rtol=1e-12)
    assert torch.count_nonzero(readout.radial_depth_m(0.4 * output)) == 0
    assert readout.metres_per_radian * 2 * math.pi == pytest.approx(299_792_458 / (2 * 20e6))
