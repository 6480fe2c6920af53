"""TensorBoard log of a training: scalars of every epoch, pictures of every tenth."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from model.data.batches import Batch
from model.network.readout import Readout
from model.training.optimisation import Optimisation


class TrainingLog:
    """Writes ``log/`` in the run folder `out`; nothing if `out` is None.

    Parameters
    ----------
    done : number of finished epochs. TensorBoard hides later epochs that an interrupted run has logged.
    """

    PICTURES = 4  # scenes in a picture
    PICTURE_EVERY = 10  # epochs

    def __init__(self, out: Path | None, done: int) -> None:
        self._writer = SummaryWriter(str(out / "log"), purge_step=done + 1) if out else None
        self._since, self._steps = time.perf_counter(), -1

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer:
            self._writer.close()

    def scalars(self, record: Mapping[str, float], optimisation: Optimisation) -> None:
        """Log an epoch's record, the norm of its last gradient, and its samples per second."""
        if not self._writer:
            return
        epoch, now = int(record["epoch"]), time.perf_counter()
        for name, value in record.items():
            if name != "epoch":
                self._writer.add_scalar(name, value, epoch)
        if optimisation.settings.clip_norm > 0:
            self._writer.add_scalar("gradient_norm", float(optimisation.gradient_norm), epoch)
        if self._steps >= 0:
            samples = (optimisation.steps - self._steps) * optimisation.settings.batch_size
            self._writer.add_scalar("samples_per_second", samples / (now - self._since), epoch)
        self._since, self._steps = now, optimisation.steps

    def wants_pictures(self, epoch: int) -> bool:
        """Whether pictures of this epoch are logged."""
        return self._writer is not None and epoch % self.PICTURE_EVERY == 1

    def pictures(self, batch: Batch, readout: Readout, output: Tensor, epoch: int) -> None:
        """Log scenes side by side, ground truth above prediction: radial depth, Re and Im of the phasor."""
        if not self._writer:
            return
        depth_m = torch.stack([batch.radial_depth_m, readout.radial_depth_m(output)])  # (2, N, H, W)
        self._writer.add_image("radial_depth", _tiles(depth_m / depth_m.max().clamp_min(1e-9)), epoch)
        components = torch.stack([batch.target, output]).clamp(-1, 1)  # (2, N, 2, H, W)
        for index, name in enumerate(("re", "im")):
            self._writer.add_image(name, _tiles((components[:, :, index] + 1) / 2), epoch)


def _tiles(images: Tensor) -> Tensor:
    """(1, 2H, N W) picture of (2, N, H, W) images."""
    rows, columns, height, width = images.shape
    return images.permute(0, 2, 1, 3).reshape(1, rows * height, columns * width).float().cpu()
