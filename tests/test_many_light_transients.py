"""Time-resolved rows of many lights hold the light of the exact phasors."""

from dataclasses import replace

import numpy as np
import pytest
from many_light_scenes import (
    FREQUENCIES_HZ,
    SHAPES,
    SMALL,
    Corner,
    ball,
    expose,
    relative,
    rough_plastic,
)

from itof import MeasurementMatrix


@pytest.mark.parametrize("name", SHAPES)
def test_phi_of_the_transient_is_the_exact_phasor_within_one_percent_of_the_hidden_signal(
    four_shapes, variant, name
):
    exposure = expose(four_shapes[name], variant, lights=256, layout=SMALL)
    exact = exposure.phasors()
    phi = MeasurementMatrix(FREQUENCIES_HZ, SMALL.bin_count, SMALL.bin_width_m, splat="tent")
    transient = np.concatenate(list(exposure.row_blocks()))
    assert transient.dtype == np.float32
    norm = np.linalg.norm(exact.hidden, axis=(0, 1))
    assert np.all(np.linalg.norm(phi.apply(transient) - exact.total, axis=(0, 1)) < 0.01 * norm)
    # At 1 Hz nothing turns: the phasor is the energy.
    steady = replace(exposure, view=replace(exposure.view, frequencies_hz=(1.0,))).phasors()
    energy = transient.sum(axis=-1, dtype=np.float64)
    difference = energy - np.abs(steady.total[..., 0])
    assert np.linalg.norm(difference) < 0.01 * np.linalg.norm(steady.hidden)
    assert abs(difference.sum()) < 0.01 * np.abs(steady.hidden).sum()


def test_the_hidden_part_of_a_transient_is_the_hidden_phasor(variant, tmp_path):
    # Without the bright direct return: what Φ sees of an object less what it sees without one.
    corner = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    phi = MeasurementMatrix(FREQUENCIES_HZ, SMALL.bin_count, SMALL.bin_width_m, splat="tent")
    full, empty = (expose(c.load(tmp_path), variant, layout=SMALL) for c in (corner, corner.but(hidden=())))
    binned = [phi.apply(np.concatenate(list(one.row_blocks()))) for one in (full, empty)]
    assert np.all(relative(binned[0] - binned[1], full.phasors().hidden) < 0.005)
