"""Figures of measurements and depth maps."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from itof import DepthMap, phasor_channels
from itof.capture.capture import Capture
from itof.capture.importing import ImportedCapture
from itof.exr.image import Image

KINDS = ("amplitude", "phase, rad")
DEPTH_M = np.array([[0, 2.5, 2.0], [0, 0, 3.0]])


def drawn(figure):
    """The values of the panels by their titles; empty pixels are NaN."""
    plt.close(figure)
    return {
        axes.get_title(): np.ma.filled(axes.images[0].get_array().astype(float), np.nan)
        for axes in figure.axes
        if axes.images
    }


def test_a_depth_map_shows_depth_and_error_where_there_is_an_object():
    one = DepthMap(DEPTH_M, DEPTH_M > 0, DEPTH_M * (1 + 0j), 20e6)
    expected = np.where(DEPTH_M > 0, DEPTH_M, np.nan)
    shown = drawn(one.plot())
    assert [*shown] == ["depth, m"]
    np.testing.assert_array_equal(shown["depth, m"], expected)
    both = DepthMap(*(np.stack([each, each]) for each in (DEPTH_M, DEPTH_M > 0, DEPTH_M + 0j)), 20e6, None)
    assert len(drawn(both.plot())) == 1
    error = DepthMap(DEPTH_M, DEPTH_M > 0, DEPTH_M + 0j, 20e6, DEPTH_M / 100)
    np.testing.assert_array_equal(drawn(error.plot())["expected error, m"], expected / 100)


def test_an_image_shows_amplitude_and_phase_of_its_phasors_and_its_other_channels():
    z = np.array([[[2.0, 1j]], [[0, -3.0]]])  # (H, W, F)
    image = Image({**phasor_channels(z, [20e6, 50e6]), "mask.M": np.ones((2, 1), np.float32)}, {})
    shown = drawn(image.plot())
    assert len(shown) == 5
    np.testing.assert_array_equal(shown["itof 20 MHz: amplitude"], [[2], [np.nan]])
    np.testing.assert_allclose(shown["itof 50 MHz: phase, rad"], [[np.pi / 2], [np.pi]], rtol=1e-6)
    np.testing.assert_array_equal(shown["mask.M"], [[1], [1]])


def test_a_capture_is_shown_above_that_of_the_empty_corner():
    seen, empty = (
        Capture(np.full((2, 3, 1), strength * 1j), (20e6,), np.zeros((2, 3)), None) for strength in (1, 4)
    )
    shown = drawn(ImportedCapture(seen, empty, Path("out.npz"), Path("out.npz.json")).plot())
    assert [*shown] == [f"{name}20 MHz: {kind}" for name in ("", "empty corner ") for kind in KINDS]
    for name, strength in (("", 1), ("empty corner ", 4)):
        np.testing.assert_array_equal(shown[f"{name}20 MHz: amplitude"], np.full((2, 3), strength))
