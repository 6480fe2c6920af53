"""Raw numbers whose range is not the declared one are refused with their true bits."""

import numpy as np
import pytest
from captures import raw_of, sidecar_of, steps, taps_of
from wall_measurements import wall_of_plane

from itof.capture.demodulating import sensor_pixels
from itof.capture.sidecar import CaptureError

RAW = np.round(1000 * taps_of(wall_of_plane().direct, steps(4), steps(2)))[None]  # (N, H, W, F, S, T)
FULL = np.minimum(np.round(5000 * RAW / RAW.max()), 4095).astype(np.uint16)  # at 12 bits
ALIGNED = {
    "stop at 4095 (12 bits), which many reach": ({"bits": 16}, FULL, "give bits = 12"),
    "stop at 4095 (12 bits)": ({}, FULL, "give bits = 12"),
    "stop at 65520 (12 bits, left-aligned)": ({"bits": 16}, 16 * FULL, "give saturation_dn = 65520"),
    "hold 65520, and 12 bits hold at most 4095": (
        {"bits": 12},
        16 * FULL,
        "all are multiples of 16, left-aligned: give saturation_dn = 65520",
    ),
    "hold 4095, and 10 bits hold at most 1023": ({"bits": 10}, FULL, "give the true bits: 12?"),
    "stop at 3000, which many reach": ({"bits": 12}, np.minimum(FULL, 3000), "give saturation_dn = 3000"),
}


@pytest.mark.parametrize("words", ALIGNED)
def test_numbers_that_stop_below_the_range_or_are_above_it_are_refused_with_their_bits(tmp_path, words):
    changes, raw, advice = ALIGNED[words]
    sidecar = sidecar_of(tmp_path, **changes)
    with pytest.raises(CaptureError) as refused:
        sensor_pixels(raw_of(sidecar, raw=raw), sidecar)
    assert words in str(refused.value)
    assert str(refused.value).endswith(advice)
    key = advice.rpartition("give ")[2].replace("the true bits: 12?", "bits = 12").split(" = ")
    sidecar = sidecar_of(tmp_path, **(changes | {key[0]: int(key[1])}))
    saturated = sensor_pixels(raw_of(sidecar, raw=raw), sidecar).saturated
    assert 0.005 < saturated.mean() < 0.5  # the brightest pixels, not all of them
