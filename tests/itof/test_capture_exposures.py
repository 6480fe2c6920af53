"""Exposure times: as many as the frames, in their order, and those of each frequency if it has its own."""

import numpy as np
import pytest
from captures import TAPS, raw_of, read_here, sidecar_of, steps, taps_of, without
from wall_measurements import wall_of_plane

from itof.capture.capture import capture_of
from itof.capture.sidecar import CaptureError

PHASOR = wall_of_plane().direct
RAW = np.round(1000 * taps_of(PHASOR, steps(4), steps(2)))[None]  # (N, H, W, F, S, T)


def test_exposure_times_must_be_as_many_as_the_frames(tmp_path):
    sidecar = sidecar_of(tmp_path, exposures_s=[1e-3, 2e-3])
    with pytest.raises(CaptureError, match="holds 1 frame, and 2 exposure times are given"):
        raw_of(sidecar, raw=RAW)
    sidecar = sidecar_of(tmp_path, exposure_array="t")
    raw = raw_of(sidecar, raw=np.concatenate([RAW, 2 * RAW]), t=np.array([1.0, 2.0]))
    assert capture_of(raw, sidecar).facts.frames == 2


def test_files_of_single_frequencies_have_exposure_times_of_their_own(tmp_path):
    times = (1.0, 2.0, 3.0)
    for place, time in enumerate(times):
        np.savez(tmp_path / f"{place}.npz", raw=time * RAW[:, :, :, place], t=[time])
    axes = ["frame", "row", "column", "step", "tap"]
    sidecar = sidecar_of(tmp_path, files="frequencies", axes=axes, exposure_array="t")
    read = read_here([tmp_path / f"{place}.npz" for place in range(3)], sidecar)
    assert read.exposures_s.tolist() == [list(times)]
    one = sidecar_of(tmp_path)
    np.testing.assert_allclose(capture_of(read, sidecar).phasor, capture_of(raw_of(one, raw=RAW), one).phasor)


def test_one_array_of_exposure_times_may_be_for_all_frequencies(tmp_path):
    for place in range(3):
        times = {"t": [5.0]} if place == 0 else {}
        np.savez(tmp_path / f"{place}.npz", raw=5 * RAW[:, :, :, place], **times)
    axes = ["frame", "row", "column", "step", "tap"]
    sidecar = sidecar_of(tmp_path, files="frequencies", axes=axes, exposure_array="t")
    read = read_here([tmp_path / f"{place}.npz" for place in range(3)], sidecar)
    assert read.exposures_s.tolist() == [[5.0, 5.0, 5.0]]


def test_arrays_that_are_frames_come_in_the_order_of_their_exposure_times(tmp_path):
    for name, factor in (("one", 1.0), ("two", 2.0)):
        np.savez(
            tmp_path / f"{name}.npz",
            a=factor * RAW[0],
            b=4 * factor * RAW[0],
            t=factor * np.array([1.0, 4.0]),
        )
    sidecar = sidecar_of(
        tmp_path,
        without(TAPS, "axes"),
        arrays=["a", "b"],
        axes=["row", "column", "frequency", "step", "tap"],
        stacked_along="frame",
        exposure_array="t",
    )
    read = read_here([tmp_path / "one.npz", tmp_path / "two.npz"], sidecar)
    assert read.exposures_s[:, 0].tolist() == [1.0, 4.0, 2.0, 8.0]
    np.testing.assert_allclose(read.values.mean(axis=(1, 2, 3, 4, 5)) / RAW.mean(), read.exposures_s[:, 0])
    assert capture_of(read, sidecar).facts.frames == 4
