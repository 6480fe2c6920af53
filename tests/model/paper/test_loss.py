"""Loss and readout give the numbers computed by hand, and gradients that lead away from every bad output."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from itof import depth_from_phase, phase, phasor_of_return
from model.network.readout import Readout
from model.paper.loss import NightLoss, intersection_over_union

READOUT = Readout(20e6)
BY_DEPTH = Readout(20e6, mask_from="depth")
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
        else ([3.0], [false_m])
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
        "mae+lovasz": (error(1) + no_overlap) / 2,  # the presence is 0 or 1, so the extension is 1 - IoU
    }
    found = {name: float(NightLoss(READOUT, name, on)(output, target, depth_m, mask)) for name in expected}
    assert found == pytest.approx(expected, rel=1e-5)


def weighted_images() -> tuple[torch.Tensor, tuple[torch.Tensor, ...]]:
    """Images with 1, 2, 5 and 0 object pixels of 6; every object pixel errs by 0.4, every other by 0.1."""
    masks = torch.zeros(4, HEIGHT, WIDTH)
    for index, count in enumerate((1, 2, 5, 0)):
        masks[index].view(-1)[:count] = 1
    target, depth_m, mask = truth(masks)
    return target + torch.where(mask[:, None] > 0, 0.4, 0.1), (target, depth_m, mask)


@pytest.mark.parametrize(
    ("balance", "expected"),
    [
        # alpha B / O of the image, times the sum over object pixels by all pixels, and the background's
        ("image", [0.5 * 5 * 0.4 / 6 + 0.5 / 6, 0.5 * 2 * 0.8 / 6 + 0.4 / 6, 0.1 * 2.0 / 6 + 0.1 / 6, 0.1]),
        # alpha 30 in every image, the same sums
        ("dataset", [15 * 0.4 / 6 + 0.5 / 6, 15 * 0.8 / 6 + 0.4 / 6, 15 * 2.0 / 6 + 0.1 / 6, 0.1]),
        # alpha B / O of the image, times the mean of each class
        ("class-means", [0.5 * 5 * 0.4 + 0.1, 0.5 * 2 * 0.4 + 0.1, 0.1 * 0.4 + 0.1, 0.1]),
    ],
)
def test_every_balance_weights_object_and_background_as_computed_by_hand(balance, expected):
    output, images = weighted_images()
    loss = NightLoss(READOUT, "mae", alpha=0.5, balance=balance, background_per_object=30.0)
    torch.testing.assert_close(loss.mean_error(output, *images), torch.tensor(expected))


def test_class_means_are_the_sums_with_another_alpha_at_one_ratio_of_the_classes_only():
    # With B / O = r the ratio of object to background is alpha r^2 for means and alpha r for sums.
    output, images = weighted_images()
    seen = {}
    for balance, alpha in (("class-means", 1 / 7), ("image", 5 / 7)):  # image 0: r = 5
        loss = NightLoss(READOUT, "mae", alpha=alpha, balance=balance)
        on_object = loss.mean_error(torch.where(images[2][:, None] > 0, output, images[0]), *images)
        seen[balance] = on_object / (loss.mean_error(output, *images) - on_object)
    assert float(seen["class-means"][0]) == pytest.approx(float(seen["image"][0]), rel=1e-5)
    assert float(seen["class-means"][1]) < 0.5 * float(seen["image"][1])  # r = 2: 2 / 5 of it


def test_the_balance_of_a_dataset_without_its_ratio_is_refused():
    with pytest.raises(ValueError, match="background_per_object"):
        NightLoss(READOUT, balance="dataset")


def test_class_means_of_an_image_that_is_all_object_are_finite():
    target, depth_m, mask = truth(torch.ones(1, HEIGHT, WIDTH))
    loss = NightLoss(READOUT, "mae", balance="class-means")
    assert float(loss(0 * target, target, depth_m, mask)) == 0  # |B| = 0: the text's weight is 0


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


@pytest.mark.parametrize("readout", [READOUT, BY_DEPTH])
def test_gradients_stay_finite_everywhere_and_stop_beyond_the_amplitude_of_the_truth(readout):
    target, depth_m, mask = truth(one_object())
    for variant in ("components", "depth"):
        for scale in (0.0, 1e-20, 0.04, 1.0, 1e6):
            output = (scale * torch.ones_like(target)).requires_grad_()
            NightLoss(readout, on=variant)(output, target, depth_m, mask).backward()
            assert torch.isfinite(output.grad).all()
    output = (3 * target).requires_grad_()
    intersection_over_union(readout.mask(output), mask).sum().backward()
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


def test_a_mask_of_the_depth_is_what_lies_above_the_threshold_in_metres():
    depth_m = torch.tensor([0.4, 2.9, 3.1, 7.0])
    z = phasor_of_return(depth_m.numpy(), 20e6)
    output = torch.from_numpy(np.stack([z.real, z.imag])[None, :, None]).float()  # (1, 2, 1, 4)
    faint = 0.2 * output  # below the threshold of the amplitude; one component at least is above 0.05
    for shown in (output, faint):
        assert BY_DEPTH.mask(shown).tolist() == [[[1.0, 1.0, 1.0, 1.0]]]
        above = Readout(20e6, mask_from="depth", mask_depth_m=3.0)
        assert above.mask(shown).tolist() == [[[0.0, 0.0, 1.0, 1.0]]]
        torch.testing.assert_close(
            above.radial_depth_m(output)[0, 0], depth_m * (depth_m > 3), rtol=1e-5, atol=0
        )
    assert READOUT.mask(faint).sum() == 0
    background = torch.tensor([[[[0.0, 0.04, 1.0]], [[0.0, -0.04, 0.04]]]])  # nothing, dead zone, phase 0
    assert BY_DEPTH.mask(background).sum() == 0
    assert torch.count_nonzero(BY_DEPTH.radial_depth_m(background)) == 0


def test_a_mask_of_the_depth_has_the_gradient_of_the_amplitude():
    output = torch.tensor([[[[-0.6, 0.8, 0.03, 1.8]], [[0.8, -0.6, 0.04, 2.4]]]], dtype=torch.float64)
    output.requires_grad_()
    mask = BY_DEPTH.mask(output)
    assert mask.tolist() == [[[1.0, 1.0, 0.0, 1.0]]]  # the third pixel is in the dead zone
    mask.sum().backward()
    directions = [[[-0.6, 0.8, 0.6, 0.0]], [[0.8, -0.6, 0.8, 0.0]]]  # none beyond the amplitude 1
    torch.testing.assert_close(output.grad[0], torch.tensor(directions, dtype=torch.float64))


def test_a_mask_of_the_depth_can_have_the_gradient_of_the_depth_where_the_mask_can_change():
    output = torch.tensor([[[[-0.6, 0.8, 0.03]], [[0.8, -0.6, 0.04]]]], dtype=torch.float64)
    # d phase = (-Im, Re) / amplitude^2; the last pixel is in the dead zone, and its amplitude counts as 0.05.
    per_metre = np.array([[[-0.8, 0.6, -0.04 / 0.05**2]], [[-0.6, 0.8, 0.03 / 0.05**2]]])
    expected = torch.from_numpy(BY_DEPTH.metres_per_radian * per_metre)
    by_phase = replace(BY_DEPTH, mask_gradient="depth")
    for sign, moves in ((1, [1.0, 1.0, 0.0]), (-1, [0.0, 0.0, 1.0])):  # lower the mask; raise it
        leaf = output.clone().requires_grad_()
        mask = by_phase.mask(leaf)
        assert torch.equal(mask, BY_DEPTH.mask(output))
        (sign * mask).sum().backward()
        torch.testing.assert_close(leaf.grad[0], sign * expected * torch.tensor(moves, dtype=torch.float64))


def test_the_gradient_of_a_depth_whose_mask_is_its_own_is_that_of_the_phase_everywhere():
    output = torch.tensor([[[[-0.6, 0.8, 0.03]], [[0.8, -0.6, 0.04]]]], dtype=torch.float64)
    # d phase = (-Im, Re) / amplitude^2; the last pixel is in the dead zone, and its amplitude counts as 0.05.
    per_metre = np.array([[[-0.8, 0.6, -0.04 / 0.05**2]], [[-0.6, 0.8, 0.03 / 0.05**2]]])
    output.requires_grad_()
    BY_DEPTH.radial_depth_m(output).sum().backward()
    expected = torch.from_numpy(BY_DEPTH.metres_per_radian * per_metre)
    torch.testing.assert_close(output.grad[0], expected)


@pytest.mark.long
@pytest.mark.parametrize("name", ["mae+iou", pytest.param("mae+lovasz", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("variant", ["components", "depth"])
def test_descent_with_a_mask_of_the_depth_finds_the_object_and_stays_at_its_depth(variant, name):
    target, depth_m, mask = truth(one_object().repeat(2, 1, 1))
    output = 1e-3 * torch.randn(target.shape, generator=torch.Generator().manual_seed(2))
    output[0] = 0
    loss = NightLoss(BY_DEPTH, name, variant)
    output.requires_grad_()
    for step in [0.5] * 1600 + [0.05] * 300:
        (gradient,) = torch.autograd.grad(loss(output, target, depth_m, mask), output)
        assert torch.isfinite(gradient).all()
        output.data -= step * gradient
    assert torch.equal(BY_DEPTH.mask(output.detach()), mask)
    # As above with a tenth of the step; but with the error of the depth, nothing pulls the amplitude to 1,
    # and a step turns the phase by 1 / amplitude times as much.
    assert (BY_DEPTH.radial_depth_m(output.detach()) - depth_m).abs().max() < 0.024


def test_depth_is_that_of_itof_over_the_whole_range_and_zero_off_the_mask():
    depth_m = np.linspace(0.1, 7.4, 40)
    z = phasor_of_return(depth_m, 20e6)
    output = torch.from_numpy(np.stack([z.real, z.imag])[None, :, None])  # (1, 2, 1, 40)
    readout = Readout(20e6, dead_zone=0.0)
    np.testing.assert_allclose(readout.radial_depth_m(output)[0, 0], depth_m, rtol=1e-12)
    np.testing.assert_allclose(depth_m, depth_from_phase(phase(z), 20e6), rtol=1e-12)
    assert torch.count_nonzero(readout.radial_depth_m(0.4 * output)) == 0
    assert readout.metres_per_radian * 2 * math.pi == pytest.approx(299_792_458 / (2 * 20e6))
