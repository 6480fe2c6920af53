"""Time-resolved rows of many lights hold the light of the exact phasors."""

import numpy as np
import pytest
from many_light_scenes import (
    FREQUENCIES_HZ,
    SHAPES,
    SMALL,
    Corner,
    ball,
    expose,
    measure,
    relative,
    rough_plastic,
)

from itof import MeasurementMatrix


@pytest.mark.parametrize("name", SHAPES)
def test_phi_of_the_transient_is_the_exact_phasor_within_a_share_of_the_hidden_signal(
    four_shapes, variant, name
):
    exposure = expose(four_shapes[name], variant, lights=512, layout=SMALL)
    exact = exposure.phasors()
    phi = MeasurementMatrix(FREQUENCIES_HZ, SMALL.bin_count, SMALL.bin_width_m, splat="quadratic")
    transient = np.concatenate(list(exposure.row_blocks()))
    assert transient.dtype == np.float32
    norm = np.linalg.norm(exact.hidden, axis=(0, 1))
    # The phasors of few lights are interpolated with a quarter of their error; the transient of a small image
    # is not.
    allowed = max(0.005, exact.error / 4)
    assert allowed < 0.05
    assert np.all(np.linalg.norm(phi.apply(transient) - exact.total, axis=(0, 1)) < allowed * norm)
    # At 1 Hz nothing turns: the phasor is the energy.
    steady = measure(four_shapes[name], variant, lights=512, layout=SMALL, frequencies_hz=(1.0,))
    energy = transient.sum(axis=-1, dtype=np.float64)
    difference = energy - np.abs(steady.total[..., 0])
    assert np.linalg.norm(difference) < allowed * np.linalg.norm(steady.hidden)
    assert abs(difference.sum()) < allowed * np.abs(steady.hidden).sum()


def test_the_hidden_part_of_a_transient_is_the_hidden_phasor(variant, tmp_path):
    # Without the bright direct return: what Φ sees of an object less what it sees without one.
    corner = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    phi = MeasurementMatrix(FREQUENCIES_HZ, SMALL.bin_count, SMALL.bin_width_m, splat="quadratic")
    full, empty = (expose(c.load(tmp_path), variant, layout=SMALL) for c in (corner, corner.but(hidden=())))
    binned = [phi.apply(np.concatenate(list(one.row_blocks()))) for one in (full, empty)]
    assert np.all(relative(binned[0] - binned[1], full.phasors().hidden) < 0.005)  # half of the promised 1 %
