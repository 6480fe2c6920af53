"""TensorBoard log of a training: scalars of every epoch, pictures of every tenth."""

from __future__ import annotations

import io
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.summary.writer.record_writer import RecordWriter
from torch import Tensor
from torch.utils.tensorboard.summary import image, scalar

from disk import inside
from model.data.batches import Batch
from model.network.readout import Readout
from model.training.optimisation import Optimisation
from model.training.refusals import naming_disk

LOG_FOLDER: Final = "log"


class TrainingLog:
    """Writes ``log/`` in the run folder `out`; nothing if `out` is None.

    The events of an epoch are appended to the file by `write`, in the caller's thread. TensorBoard's own
    writer has a thread, which ends with a traceback when the disk is full.

    Parameters
    ----------
    done : number of finished epochs. TensorBoard hides later epochs that an interrupted run has logged.

    Raises
    ------
    OutsideError : ``log`` is a symbolic link that leads out of the run folder.
    """

    PICTURES = 4  # scenes in a picture
    PICTURE_EVERY = 10  # epochs

    def __init__(self, out: Path | None, done: int) -> None:
        # The name begins as TensorBoard expects it; time and process make it unique.
        name = f"events.out.tfevents.{time.time_ns()}.{socket.gethostname()}.{os.getpid()}"
        self._file = inside(out, LOG_FOLDER, name) if out else None
        self._waiting = io.BytesIO()
        self._since, self._steps = time.perf_counter(), -1
        self._add(done + 1, file_version="brain.Event:2")
        self._add(done + 1, session_log=SessionLog(status=SessionLog.START))

    def write(self) -> None:
        """Append all that was logged to the file.

        Raises
        ------
        RunError : the file cannot be written.
        """
        if self._file is None:
            return
        with naming_disk(self._file):
            self._file.parent.mkdir(exist_ok=True)
            with self._file.open("ab") as stream:
                stream.write(self._waiting.getvalue())
        self._waiting = io.BytesIO()

    def scalars(self, record: Mapping[str, float], optimisation: Optimisation, samples: int) -> None:
        """Log an epoch's record, the norm of its last gradient, and its samples per second with validation.

        Parameters
        ----------
        samples : number of training samples of an epoch.
        """
        epoch, now = int(record["epoch"]), time.perf_counter()
        for name, value in record.items():
            if name != "epoch":
                self._add(epoch, summary=scalar(name, value))
        if optimisation.settings.clip_norm > 0:
            self._add(epoch, summary=scalar("gradient_norm", float(optimisation.gradient_norm)))
        if self._steps >= 0:
            self._add(epoch, summary=scalar("samples_per_second", samples / (now - self._since)))
        self._since, self._steps = now, optimisation.steps

    def wants_pictures(self, epoch: int) -> bool:
        """Whether pictures of this epoch are logged."""
        return self._file is not None and epoch % self.PICTURE_EVERY == 1

    def pictures(self, batch: Batch, readout: Readout, output: Tensor, epoch: int) -> None:
        """Log scenes side by side, ground truth above prediction: radial depth, Re and Im of the phasor."""
        depth_m = torch.stack([batch.radial_depth_m, readout.radial_depth_m(output)])  # (2, N, H, W)
        self._picture(epoch, "radial_depth", depth_m / depth_m.max().clamp_min(1e-9))
        if readout.target != "components":
            output = readout.components(output)
        components = torch.stack([batch.target, output]).clamp(-1, 1)  # (2, N, 2, H, W)
        for index, name in enumerate(("re", "im")):
            self._picture(epoch, name, (components[:, :, index] + 1) / 2)

    def _picture(self, epoch: int, name: str, images: Tensor) -> None:
        self._add(epoch, summary=image(name, _tiles(images), dataformats="CHW"))

    def _add(self, step: int, **content: Any) -> None:
        event = Event(wall_time=time.time(), step=step, **content)
        RecordWriter(self._waiting).write(event.SerializeToString())


def _tiles(images: Tensor) -> Tensor:
    """(1, 2H, N W) picture of (2, N, H, W) images."""
    rows, columns, height, width = images.shape
    return images.permute(0, 2, 1, 3).reshape(1, rows * height, columns * width).float().cpu()
