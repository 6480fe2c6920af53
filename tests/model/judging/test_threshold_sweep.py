"""The sweep of the mask threshold: every point is what judging at that threshold gives."""

from dataclasses import replace

import numpy as np
import pytest

from itof import phasor_of_return
from itof.metrics import image_metrics
from model.judging.calibration import SWEEP, ThresholdSweep, output_of
from model.network.readout import Readout
from model.prediction.predictor import read_output


def test_every_point_of_a_sweep_is_what_judging_at_it_gives():
    rng = np.random.default_rng(7)
    shape = (3, 5, 8)
    phasor = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    phasor = (0.5 * phasor).astype(np.complex64)
    truth_m = np.where(rng.random(shape) < 0.3, 2.5, 0.0).astype(np.float32)
    truth_m[2] = 0  # a scene without object
    readout = Readout(20e6)
    sweep = ThresholdSweep("test", SWEEP, readout)
    sweep.add(phasor, truth_m, (truth_m > 0).astype(np.uint8))
    for point in sweep.curve().points:
        found = read_output(output_of(phasor), replace(readout, mask_threshold=point.threshold))
        images = zip(found.radial_depth_m, found.mask, truth_m, truth_m > 0, strict=True)
        each = [image_metrics(*image) for image in images]
        assert point.miou == pytest.approx(np.mean([m.miou for m in each]), rel=1e-12)
        assert point.depth_mae_m == pytest.approx(np.mean([m.depth_mae_m for m in each]), rel=1e-6)


def test_the_sweep_finds_the_threshold_that_parts_object_from_background():
    # Amplitude 0.72 on the object and 0.68 beside it: of the thresholds swept only 0.70 parts them.
    truth = np.zeros((1, 6, 9), dtype=np.uint8)
    truth[0, 2:4, 3:7] = 1
    amplitude = np.where(truth > 0, 0.72, 0.68)
    phasor = (amplitude * phasor_of_return(np.full(truth.shape, 2.0), 20e6)).astype(np.complex64)
    sweep = ThresholdSweep("validation", SWEEP, Readout(20e6, dead_zone=0.0))
    sweep.add(phasor, (2.0 * truth).astype(np.float32), truth)
    best = sweep.curve().best
    assert (best.threshold, best.miou) == (0.7, 1.0)
    assert best.depth_mae_m == pytest.approx(0.0, abs=1e-5)
