"""Augmentation against doing it by hand, alike in input and truth."""

import math

import pytest
import torch

from model import Augmentation, Batch, Warp, augmentation_named

HEIGHT, WIDTH = 6, 10
NO_FLIP = torch.tensor([False, False])


def batch_of(count: int = 2, height: int = HEIGHT, width: int = WIDTH) -> Batch:
    generator = torch.Generator().manual_seed(0)
    mask = (torch.rand(count, height, width, generator=generator) < 0.3).float()
    target = torch.randn(count, 2, height, width, generator=generator) * mask[:, None]
    return Batch(
        torch.randn(count, 3, height, width, generator=generator), target, 3 * target[:, 0].abs(), mask
    )


def warp(*, rows: bool = False, columns: bool = False, angle_rad: float = 0.0, shift=(0.0, 0.0)) -> Warp:
    def alike(value: bool) -> torch.Tensor:
        return torch.tensor([value, value])

    return Warp(alike(rows), alike(columns), torch.full((2,), angle_rad), torch.tensor([shift, shift]))


def assert_each(result: Batch, batch: Batch, change, *, atol: float) -> None:
    """`change` done by hand to input and every truth gives the result; truth must match to the bit."""
    torch.testing.assert_close(result.channels, change(batch.channels), rtol=0, atol=atol)
    for name in ("target", "radial_depth_m", "mask"):
        assert torch.equal(getattr(result, name), change(getattr(batch, name))), name


def test_no_augmentation_changes_nothing():
    batch = batch_of()
    assert_each(
        augmentation_named("none")(batch, torch.Generator().manual_seed(0)), batch, lambda x: x, atol=0
    )


def test_flips_are_flips():
    batch = batch_of()
    assert_each(warp(rows=True)(batch), batch, lambda x: x.flip(-2), atol=0)
    assert_each(warp(columns=True)(batch), batch, lambda x: x.flip(-1), atol=0)


def test_half_a_turn_is_both_flips():
    batch = batch_of()
    # grid_sample measures positions in float32 half images: about 1e-6 pixels, times slopes of a few units.
    assert_each(warp(angle_rad=math.pi)(batch), batch, lambda x: x.flip(-1).flip(-2), atol=2e-5)


@pytest.mark.parametrize("quarter_turns", [1, -1])
def test_a_quarter_turn_of_a_square_is_rot90(quarter_turns):
    batch = batch_of(height=8, width=8)
    # A positive angle turns right towards down: rot90 over (columns, rows).
    result = warp(angle_rad=quarter_turns * math.pi / 2)(batch)
    assert_each(result, batch, lambda x: torch.rot90(x, quarter_turns, (-1, -2)), atol=2e-5)


def test_a_quarter_turn_of_a_wide_image_keeps_pixels_square():
    batch = batch_of(height=4, width=8)
    result = warp(angle_rad=math.pi / 2)(batch)
    middle = batch.mask[..., 2:6]  # the square that turns into itself
    assert torch.equal(result.mask[..., 2:6], torch.rot90(middle, 1, (-1, -2)))


def test_a_shift_by_whole_pixels_moves_truth_over_background_and_repeats_the_input_edge():
    batch = batch_of()
    result = warp(shift=(2 / WIDTH, -1 / HEIGHT))(batch)  # two to the right, one up
    assert torch.equal(result.mask[:, :-1, 2:], batch.mask[:, 1:, :-2])
    assert torch.equal(result.target[:, :, :-1, 2:], batch.target[:, :, 1:, :-2])
    assert torch.equal(result.radial_depth_m[:, :-1, 2:], batch.radial_depth_m[:, 1:, :-2])
    assert torch.count_nonzero(result.mask[:, :, :2]) + torch.count_nonzero(result.mask[:, -1]) == 0
    torch.testing.assert_close(result.channels[..., :-1, 2:], batch.channels[..., 1:, :-2], rtol=0, atol=2e-5)
    torch.testing.assert_close(result.channels[..., :-1, 0], batch.channels[..., 1:, 0], rtol=0, atol=2e-5)


def test_input_and_truth_move_together_under_every_kind_of_warp():
    # A smooth blob in the input, the same blob thresholded as truth: after any warp its centre must agree.
    y, x = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    blob = torch.exp(-((x - 36) ** 2 + (y - 20) ** 2) / 30).repeat(6, 1, 1)  # (6, H, W)
    mask = (blob > 0.5).float()
    batch = Batch(blob[:, None], torch.stack([mask, mask], 1), 2 * mask, mask)
    result = augmentation_named("paper")(batch, torch.Generator().manual_seed(5))
    assert torch.equal(result.target[:, 0], result.mask)
    assert torch.equal(result.radial_depth_m, 2 * result.mask)
    for channel, moved in zip(result.channels[:, 0], result.mask, strict=True):
        inside = channel > 0.5
        # nearest and bilinear may disagree on the one-pixel rim of a disc of radius 4.6: 29 of 66 pixels
        assert torch.count_nonzero(inside != (moved > 0)) <= 29
        centres = [(a * g).sum() / a.sum() for a in (inside.float(), moved) for g in (x, y)]
        assert abs(centres[0] - centres[2]) < 0.5
        assert abs(centres[1] - centres[3]) < 0.5


def test_draws_stay_in_range_differ_between_images_and_repeat_with_the_seed():
    augmentation = augmentation_named("paper")
    drawn = augmentation.draw_warp(2000, torch.Generator().manual_seed(3))
    assert 0.99 * math.pi < float(drawn.angle_rad.abs().max()) <= math.pi
    assert 0.19 < float(drawn.shift.abs().max()) <= 0.2
    # A fair coin, 2000 times: within 4.5 standard deviations of a half.
    assert abs(float(drawn.flip_rows.float().mean()) - 0.5) < 4.5 * 0.5 / 2000**0.5
    again = augmentation.draw_warp(2000, torch.Generator().manual_seed(3))
    assert torch.equal(drawn.angle_rad, again.angle_rad)


def test_flip_touches_rows_alone():
    drawn = augmentation_named("flip").draw_warp(100, torch.Generator().manual_seed(0))
    assert drawn.flip_rows.any()
    assert not drawn.flip_columns.any()
    assert not drawn.angle_rad.any()
    assert not drawn.shift.any()


def test_noise_has_the_deviation_of_its_channel_and_spares_the_truth():
    batch = batch_of(2, 100, 150)
    std = torch.tensor([0.0, 0.1, 2.0])
    result = Augmentation(noise_std=std)(batch, torch.Generator().manual_seed(0))
    noise = result.channels - batch.channels
    # The deviation of n = 30000 values has a relative error of 1 / sqrt(2 n) = 0.4 %; 4.5 of those.
    torch.testing.assert_close(noise.std(dim=(0, 2, 3)), std, rtol=0.018, atol=0)
    assert torch.equal(result.target, batch.target)
