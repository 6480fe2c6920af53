"""Augmentation gives the same as its formulas in numpy, and moves input and truth together."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from wall_rows import HEIGHT, WIDTH, batch_of, draws_of, measured_rows

from itof import network_channels, residual_channels
from model.data.augmentation import Augmentation
from model.data.batches import Batch
from model.paper.augmentation import PaperAugmentation, Warp

PAPER = PaperAugmentation(flip_rows=True, flip_columns=True, rotation_deg=180.0, translation=0.2)


def warp(*, rows: bool = False, columns: bool = False, angle_rad: float = 0.0, shift=(0.0, 0.0)) -> Warp:
    def alike(value: bool) -> torch.Tensor:
        return torch.tensor([value, value])

    return Warp(alike(rows), alike(columns), torch.full((2,), angle_rad), torch.tensor([shift, shift]))


def assert_each(result: Batch, batch: Batch, change, *, atol: float) -> None:
    """The result is `change` of the input and of every ground truth; the ground truth to the bit."""
    torch.testing.assert_close(result.channels, change(batch.channels), rtol=0, atol=atol)
    for name in ("target", "radial_depth_m", "mask"):
        assert torch.equal(getattr(result, name), change(getattr(batch, name))), name


def test_no_augmentation_changes_nothing():
    rows, maker, _, _ = measured_rows()
    result, plain = Augmentation()(rows, maker, draws_of(5)), maker.batch(rows)
    for name in ("channels", "target", "radial_depth_m", "mask"):
        assert torch.equal(getattr(result, name), getattr(plain, name)), name


def test_an_augmented_pair_is_what_augmenting_by_hand_gives():
    rows, maker, phasor, direct = measured_rows()
    draws = draws_of(5, seed=1)
    both = Augmentation(flip_rows=True, amplitude_spread=0.5, noise_sigma=1e-4)
    result = both(rows, maker, draws)
    assert 0 < int(draws.coins[:, 0].sum()) < 5  # some images are flipped and some are not
    for index in range(5):
        generator = torch.Generator().manual_seed(int(draws.noise_seed[index]))
        noise = torch.randn(HEIGHT, WIDTH, 2, 2, generator=generator).double().numpy() @ np.array([1, 1j])
        bright = phasor[index] * 1.5 ** float(draws.brightness[index])
        noisy = bright + 1e-4 * np.abs(bright[..., :1]) * noise
        residual = residual_channels(noisy, direct) / np.array([1e-3, 2e-3, 3e-3])[:, None, None]
        expected = np.concatenate([network_channels(noisy, 0.3), residual])  # (C, H, W)
        target = torch.view_as_real(rows.target[index]).movedim(-1, 0)  # (2, H, W)
        truths = [target, rows.radial_depth_m[index], rows.mask[index].float()]
        if draws.coins[index, 0]:
            expected, truths = expected[:, ::-1], [truth.flip(-2) for truth in truths]
        # Phasors are complex64: 1e-7 of 1, divided by the residual's scale of 1e-3.
        np.testing.assert_allclose(result.channels[index].numpy(), expected, atol=5e-4)
        for name, truth in zip(("target", "radial_depth_m", "mask"), truths, strict=True):
            assert torch.equal(getattr(result, name)[index], truth), name


def test_our_flip_of_the_rows_is_that_of_the_papers_changes():
    rows, maker, _, _ = measured_rows()
    ours, theirs = (
        each(rows, maker, draws_of(5, seed=1))
        for each in (Augmentation(flip_rows=True), PaperAugmentation(flip_rows=True))
    )
    assert_each(ours, theirs, lambda x: x, atol=0)
    assert not torch.equal(ours.channels, maker.batch(rows).channels)


def test_a_flip_of_the_rows_is_that_of_the_measurement_itself():
    # The wall stands upright and the camera looks along the floor: its direct return is symmetric.
    rows, maker, _, direct = measured_rows()
    np.testing.assert_allclose(direct, direct[::-1], rtol=1e-12)
    always = replace(draws_of(5), coins=torch.ones(5, 2, dtype=torch.bool))
    flipped = Augmentation(flip_rows=True)(rows, maker, always)
    upside_down = maker.batch(rows, rows.phasors.flip(1))
    # The reference is complex64, alike above and below to 1e-7, over the residual's scale of 1e-3.
    torch.testing.assert_close(flipped.channels, upside_down.channels, rtol=0, atol=5e-4)


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
    # A smooth blob is the input, and the thresholded blob the truth: any warp gives both the same centre.
    y, x = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    blob = torch.exp(-((x - 36) ** 2 + (y - 20) ** 2) / 30).repeat(6, 1, 1)  # (6, H, W)
    mask = (blob > 0.5).float()
    batch = Batch(blob[:, None], torch.stack([mask, mask], 1), 2 * mask, mask)
    result = PAPER.warp(draws_of(6, seed=5))(batch)
    assert torch.equal(result.target[:, 0], result.mask)
    assert torch.equal(result.radial_depth_m, 2 * result.mask)
    for channel, moved in zip(result.channels[:, 0], result.mask, strict=True):
        inside = channel > 0.5
        # nearest and bilinear may differ on the outline of a disc of radius 4.6 pixels: 29 of its 66 pixels
        assert torch.count_nonzero(inside != (moved > 0)) <= 29
        centres = [(a * g).sum() / a.sum() for a in (inside.float(), moved) for g in (x, y)]
        # They are on the outline, on both sides of it alike: the centre moves by less than half a pixel.
        assert abs(centres[0] - centres[2]) < 0.5
        assert abs(centres[1] - centres[3]) < 0.5


def test_draws_stay_in_range_differ_between_images_and_repeat_with_the_seed():
    drawn = PAPER.warp(draws_of(2000, seed=3))
    assert 0.99 * math.pi < float(drawn.angle_rad.abs().max()) <= math.pi
    assert 0.19 < float(drawn.shift.abs().max()) <= 0.2  # else missed with the probability 0.95^4000
    # A fair coin, 2000 times: within 4.5 standard deviations of a half.
    assert abs(float(drawn.flip_rows.float().mean()) - 0.5) < 4.5 * 0.5 / 2000**0.5
    again = PAPER.warp(draws_of(2000, seed=3))
    assert torch.equal(drawn.angle_rad, again.angle_rad)


def test_flip_touches_rows_alone():
    drawn = PaperAugmentation(flip_rows=True).warp(draws_of(100))
    assert drawn.flip_rows.any()
    assert not drawn.flip_columns.any()
    assert not drawn.angle_rad.any()
    assert not drawn.shift.any()


def test_sensor_noise_has_its_deviation_on_every_component_and_is_each_images_own():
    rows, _, _, _ = measured_rows(200)
    sigma, draws = 1e-3, draws_of(200)
    phasor = rows.phasors
    noise = Augmentation(noise_sigma=sigma).measured(phasor, draws) - phasor
    relative = torch.view_as_real(noise / phasor[..., :1].abs())  # (N, H, W, F, 2)
    # The deviation of n = 12000 values has a relative error of 1 / sqrt(2 n) = 0.65 %; 4.5 of those.
    torch.testing.assert_close(relative.std(dim=(0, 1, 2)), torch.full((2, 2), sigma), rtol=0.03, atol=0)
    assert abs(float((relative[0] * relative[1]).mean())) < 4.5 * sigma**2 / (4 * HEIGHT * WIDTH) ** 0.5
    # The noise of an image does not depend on the other images of the batch.
    alone = Augmentation(noise_sigma=sigma).measured(phasor[7:8], draws[7:8])
    assert torch.equal(alone[0], (phasor + noise)[7])


def test_the_noise_of_images_is_spread_evenly_in_the_logarithm_between_two_bounds():
    rows, _, _, _ = measured_rows(200)
    draws, least, most = draws_of(200), 1e-4, 1e-2
    noise = Augmentation(noise_sigma=least, largest_noise_sigma=most).measured(rows.phasors, draws)
    relative = torch.view_as_real((noise - rows.phasors) / rows.phasors[..., :1].abs())
    each = relative.flatten(1).std(dim=1) / least  # (N,)
    share = each.log10() / 2  # of the range
    # A deviation of 240 values has a relative error of 4.6 %, which is 0.01 of the range; 4.5 of those.
    assert -0.045 < share.min() < share.max() < 1.045
    # 200 values that are even in 0 to 1: mean and standard deviation to 4.5 standard errors.
    assert abs(float(share.mean()) - 0.5) < 4.5 * 12**-0.5 / 200**0.5
    assert abs(float(share.std()) - 12**-0.5) < 4.5 * 12**-0.5 / 200**0.5


def test_another_exposure_changes_the_amplitude_channel_alone():
    rows, maker, _, _ = measured_rows()
    draws = draws_of(5)
    result, plain = (
        Augmentation(amplitude_spread=1.0)(rows, maker, draws).channels,
        maker.batch(rows).channels,
    )
    gain = 2**draws.brightness
    torch.testing.assert_close(result[:, 0], plain[:, 0] * gain[:, None, None], rtol=1e-6, atol=0)
    # float32 rounds the direct part by 2^-24, some ten times; the unit is the hidden part, about 1e-3 of it.
    torch.testing.assert_close(result[:, 1:], plain[:, 1:], rtol=0, atol=5e-4)
    assert float(gain.min()) >= 0.5
    assert float(gain.max()) <= 2


def test_noise_of_the_channels_has_its_deviation_on_each_of_them_and_is_each_images_own():
    rows, maker, _, _ = measured_rows(200)
    draws, plain = draws_of(200), maker.batch(rows).channels  # (N, C, H, W)
    noisy = PaperAugmentation(channel_noise_sigma=1.0)(rows, maker, draws)
    noise = noisy.channels - plain
    # n = 12000 values a channel: the deviation has a relative error of 1 / sqrt(2 n) = 0.65 %, the mean one
    # of 1 / sqrt(n) = 0.9 %; 4.5 of those.
    channels = torch.ones(plain.shape[1])
    torch.testing.assert_close(noise.std(dim=(0, 2, 3)), channels, rtol=0.03, atol=0)
    torch.testing.assert_close(noise.mean(dim=(0, 2, 3)), 0 * channels, rtol=0, atol=0.041)
    apart = [torch.corrcoef(pair)[0, 1] for pair in (noise[:2].flatten(1), noise[0, :2].flatten(1))]
    assert max(map(abs, apart)) < 4.5 / (HEIGHT * WIDTH) ** 0.5  # images, and channels of an image
    alone = PaperAugmentation(channel_noise_sigma=1.0).seen(plain[7:8], draws[7:8])
    assert torch.equal(alone[0], noisy.channels[7])
    for name in ("target", "radial_depth_m", "mask"):
        assert torch.equal(getattr(noisy, name), getattr(maker.batch(rows), name)), name


def test_noise_of_the_channels_is_not_smoothed_by_a_rotation():
    rows, maker, _, _ = measured_rows(200)
    turned = replace(PAPER, channel_noise_sigma=1.0)(rows, maker, draws_of(200)).channels
    noise = turned - PAPER(rows, maker, draws_of(200)).channels
    # Bilinear interpolation of noise would leave 2/3 of its deviation on the average over positions.
    assert float(noise.std()) == pytest.approx(1, rel=0.01)


def test_noise_of_the_channels_and_of_the_phasors_are_different_numbers():
    rows, _, _, _ = measured_rows(200)
    draws = draws_of(200)
    phasor = rows.phasors
    sensor = Augmentation(noise_sigma=1.0).measured(phasor, draws) - phasor
    relative = torch.view_as_real(sensor / phasor[..., :1].abs()).flatten()[: 200 * HEIGHT * WIDTH]
    channels = torch.zeros(200, 4, HEIGHT, WIDTH)
    other = PaperAugmentation(channel_noise_sigma=1.0).seen(channels, draws).flatten()[: len(relative)]
    assert abs(float(torch.corrcoef(torch.stack([relative, other]))[0, 1])) < 4.5 / len(relative) ** 0.5
