"""Constants of the network's input channels, fitted on the training scenes."""

from dataclasses import replace

import numpy as np
import pytest

from model.data.channel_scaling import fit_input_spec
from model.data.shards import Shards
from model.network.channels import ChannelError


@pytest.mark.parametrize(("channels", "count"), [("paper", 7), ("residual", 5), ("paper+residual", 12)])
def test_input_channels_are_scaled_by_the_training_scenes(shards, channels, count):
    rows = shards.rows("train")
    spec = fit_input_spec(channels, shards, rows)
    network_input = spec.apply(shards.read(rows).phasors, shards.reference)  # (N, C, H, W)
    assert spec.channel_count == count == network_input.shape[1]
    if "paper" in channels:
        assert network_input[:, 0].mean() == pytest.approx(1, rel=1e-5)
        np.testing.assert_allclose(np.hypot(network_input[:, 1], network_input[:, 4]), 1, rtol=1e-6)
    if "residual" in channels:
        np.testing.assert_allclose(network_input[:, -5:].std(axis=(0, 2, 3)), 1, rtol=1e-5)  # float32


def test_channels_of_some_of_the_frequencies_are_scaled_by_them_alone(shards):
    rows = shards.rows("train")
    spec = fit_input_spec("paper+residual", shards, rows, [50e6, 60e6])
    places = spec.places(shards.manifest.frequencies_hz)
    assert places == [1, 2]
    network_input = spec.apply(shards.read(rows).phasors[..., places], shards.reference[..., places])
    assert spec.channel_count == 5 + 3 == network_input.shape[1]
    assert network_input[:, 0].mean() == pytest.approx(1, rel=1e-5)  # the amplitude at 50 MHz
    np.testing.assert_allclose(network_input[:, -3:].std(axis=(0, 2, 3)), 1, rtol=1e-3)
    with pytest.raises(ValueError, match="10 MHz is not among 20, 50, 60 MHz"):
        fit_input_spec("paper", shards, rows, [10e6])


def test_numbers_that_overflow_name_the_folder_of_the_shards(shards, monkeypatch):
    read = Shards.read

    def glaring(self, rows):
        block = read(self, rows)
        return replace(block, phasors=np.full_like(block.phasors, 3e38 * (1 + 1j)))

    monkeypatch.setattr(Shards, "read", glaring)
    with pytest.raises(ChannelError, match="shards have numbers that are too large"):
        fit_input_spec("residual", shards, shards.rows("train"))


def test_an_amplitude_channel_divided_by_the_maximum_of_the_training_scenes_fills_zero_to_one(shards):
    rows = shards.rows("train")
    by_mean, spec = (
        fit_input_spec("paper+residual", shards, rows, amplitude_divisor=divisor)
        for divisor in ("mean", "maximum")
    )
    network_input = spec.apply(shards.read(rows).phasors, shards.reference)  # (N, C, H, W)
    assert network_input[:, 0].max() == pytest.approx(1, rel=1e-6)
    assert network_input[:, 0].min() > 0
    plain = by_mean.apply(shards.read(rows).phasors, shards.reference)
    np.testing.assert_array_equal(network_input[:, 1:], plain[:, 1:])  # no other channel depends on it
    np.testing.assert_allclose(network_input[:, 0], plain[:, 0] / plain[:, 0].max(), rtol=1e-6)
    assert spec.mean_amplitude == by_mean.mean_amplitude == by_mean.amplitude_scale < spec.amplitude_scale


def test_the_scale_is_that_of_scenes_spread_over_all(shards, monkeypatch):
    rows = shards.rows("train")
    monkeypatch.setattr("model.data.channel_scaling.SCENES", len(rows) // 2)
    some = [rows[place * len(rows) // (len(rows) // 2)] for place in range(len(rows) // 2)]
    found = fit_input_spec("paper+residual", shards, rows)
    assert found == fit_input_spec("paper+residual", shards, some)
    brightest = fit_input_spec("paper", shards, rows, amplitude_divisor="maximum").amplitude_scale
    assert brightest == max(np.abs(shards.read(rows).phasors[..., 0]).max(axis=(1, 2)))
