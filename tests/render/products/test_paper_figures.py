"""Facts about the paper's ground truth that the numbers in its figures give away."""

import numpy as np
import pytest

from itof import depth_from_phase

# Caligiuri et al. 2024, Fig. 5, limits of the colours of the five rows: smallest Re and largest Im.
SMALLEST_RE = (
    -0.672179222106934,
    -0.629554510116577,
    -0.795544564723969,
    -0.752599239349365,
    -0.723187863826752,
)
LARGEST_IM = (0.91536283493042, 0.882408857345581, 0.913667142391205, 0.895085513591766, 0.910227537155151)


@pytest.mark.parametrize(
    "phase",
    [np.arccos(SMALLEST_RE), np.pi - np.arcsin(LARGEST_IM)],  # farthest, nearest; the phase is in [π/2, π]
    ids=["farthest", "nearest"],
)
def test_the_colour_limits_of_figure_5_are_phasors_of_amplitude_1_at_whole_millimetres(phase):
    depth_m = depth_from_phase(phase, 20e6)
    assert (depth_m > 2.3).all()
    assert (depth_m < 3).all()
    # Components are float32. A depth is known to 1.2 m per radian x 6e-8 / (sin or cos of the phase, at least
    # 0.4 here), 0.2 micrometres. With an amplitude other than 1, millimetres would not be whole.
    np.testing.assert_allclose(depth_m, np.round(depth_m, 3), rtol=0, atol=2e-7)
