"""Calibration: metrics of a split for many mask thresholds, from one pass through the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from itof import DepthMap
from model.network.readout import Readout
from model.prediction.predictor import read_output
from scenegen import Split

SWEEP = tuple(round(0.05 * step, 2) for step in range(1, 20))  # 0.05 .. 0.95


@dataclass(frozen=True)
class ThresholdPoint:
    """Averages over the scenes of a split for one mask threshold; MAE over all pixels, metres."""

    threshold: float
    miou: float
    depth_mae_m: float


@dataclass(frozen=True)
class ThresholdCurve:
    """Averages over the scenes of a split for ascending mask thresholds."""

    split: Split
    points: tuple[ThresholdPoint, ...]

    @property
    def best(self) -> ThresholdPoint:
        """The point with the highest mIoU; among equals the lowest MAE, then the lowest threshold."""
        return max(self.points, key=lambda p: (p.miou, -p.depth_mae_m, -p.threshold))

    def at(self, threshold: float) -> ThresholdPoint:
        """The point of a threshold; `KeyError` if the sweep does not contain it."""
        return {p.threshold: p for p in self.points}[threshold]


@dataclass(frozen=True)
class Calibration:
    """Sweeps of the amplitude's threshold on the judged split and on the validation split.

    Attributes
    ----------
    run_readout : readout in the settings of the run.
    judged_readout : readout of the evaluation; the run's own unless the user gave another.
    judged : sweep of the judged split.
    validation : sweep of the validation split; None if the dataset has none.
    """

    run_readout: Readout
    judged_readout: Readout
    judged: ThresholdCurve
    validation: ThresholdCurve | None

    @property
    def has_amplitude(self) -> bool:
        """Whether masks can depend on a threshold of the amplitude; networks of the depth have none."""
        return self.run_readout.target != "depth"

    @property
    def best_on_validation(self) -> ThresholdPoint | None:
        """The best point of the validation split; None without one, or without an amplitude."""
        return self.validation.best if self.validation and self.has_amplitude else None

    @property
    def run_threshold(self) -> float:
        """Threshold of the amplitude in the settings of the run."""
        return self.run_readout.mask_threshold

    @property
    def judged_threshold(self) -> float | None:
        """Threshold of the amplitude in the evaluation; None if its masks are those of the depth."""
        return None if self.judged_readout.mask_from == "depth" else self.judged_readout.mask_threshold

    @property
    def is_of_run(self) -> bool:
        """Whether the evaluation takes the masks of the run."""
        return self.judged_readout == self.run_readout

    @property
    def judged_with(self) -> str:
        """What the masks of the evaluation are taken from, as text."""
        own = self.run_readout.rule
        if self.judged_readout.mask_from == self.run_readout.mask_from:
            own = own.removeprefix("mask threshold ")
        of_run = "the run's own" if self.is_of_run else f"the run's own is {own}"
        return f"judged with {self.judged_readout.rule} ({of_run})"


class ThresholdSweep:
    """Metrics of the images of a split at every threshold of the amplitude.

    A pixel belongs to the mask of every threshold up to its amplitude. Pixels and errors are therefore
    counted once, by the number of thresholds that a pixel reaches; cumulative sums of these histograms give
    the metrics at all thresholds.
    """

    def __init__(self, split: Split, thresholds: Sequence[float], readout: Readout) -> None:
        self.split, self.thresholds, self._readout = split, sorted({*thresholds}), readout.of_phasors
        self._miou: list[NDArray[np.float64]] = []
        self._depth_mae_m: list[NDArray[np.float64]] = []

    def add(
        self,
        phasor: NDArray[np.complex64],
        radial_depth_gt_m: NDArray[np.float32],
        mask_gt: NDArray[np.uint8],
    ) -> None:
        """Add images (N, H, W): predicted phasors, true radial depth in metres, true mask."""
        output = output_of(phasor)  # (N, 2, H, W)
        readout = replace(self._readout, mask_from="amplitude", mask_threshold=0.0)
        everywhere = read_output(output, readout).radial_depth_m
        amplitudes = self._readout.components(output).norm(dim=1).cpu().numpy()  # (N, H, W)
        for depth_m, amplitude, truth_m, truth in zip(
            everywhere, amplitudes, radial_depth_gt_m, mask_gt > 0, strict=True
        ):
            self._add_image(depth_m, amplitude, truth_m.astype(np.float64), truth)

    def curve(self) -> ThresholdCurve:
        """Averages over all images for ascending thresholds."""
        miou, mae_m = np.mean(self._miou, axis=0), np.mean(self._depth_mae_m, axis=0)  # (T,)
        rows = zip(self.thresholds, miou, mae_m, strict=True)
        return ThresholdCurve(self.split, tuple(ThresholdPoint(t, float(i), float(m)) for t, i, m in rows))

    def _add_image(
        self,
        depth_m: NDArray[np.float32],
        amplitude: NDArray[np.float32],
        truth_m: NDArray[np.float64],
        truth: NDArray[np.bool_],
    ) -> None:
        levels = np.asarray(self.thresholds, dtype=amplitude.dtype)  # (T,)
        reached = np.searchsorted(levels, amplitude.ravel(), side="right")  # thresholds up to the amplitude

        def total(weights: NDArray[np.float64]) -> NDArray[np.float64]:
            sums = np.bincount(reached, weights.ravel(), minlength=len(levels) + 1)  # (T + 1,)
            return sums.astype(np.float64)

        shown = _from_above(total(np.ones(truth.shape)))
        hit = _from_above(total(truth.astype(np.float64)))
        error_m = _from_above(total(np.abs(depth_m - truth_m)))
        missed_m = np.cumsum(total(np.abs(truth_m)))[:-1]  # the predicted background has depth 0
        union = shown + truth.sum() - hit
        object_iou = np.divide(hit, union, out=np.ones_like(hit), where=union > 0)
        neither, apart = truth.size - union, truth.size - hit
        background_iou = np.divide(neither, apart, out=np.ones_like(hit), where=apart > 0)
        self._miou.append(np.mean([object_iou, background_iou], axis=0))
        self._depth_mae_m.append((error_m + missed_m) / truth.size)


def reread(prediction: DepthMap, readout: Readout) -> DepthMap:
    """Depth maps (N, H, W) of the same network outputs, read with another readout."""
    read = read_output(output_of(prediction.phasor), readout.of_phasors)
    return replace(read, frequency_hz=readout.frequency_hz, depth_error_m=prediction.depth_error_m)


def output_of(phasor: NDArray[np.complex64]) -> Tensor:
    """(N, 2, H, W) network output of predicted phasors (N, H, W)."""
    return torch.from_numpy(np.stack([phasor.real, phasor.imag], axis=1))


def _from_above(by_level: NDArray[np.float64]) -> NDArray[np.float64]:
    """(T,) sums over the pixels that reach each threshold, from (T + 1,) sums by thresholds reached."""
    return np.cumsum(by_level[::-1])[::-1][1:]
