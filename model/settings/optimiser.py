"""How the weights are updated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import DOCUMENTED
from disk.quantities import NotNegative, Positive, WholeCount

Algorithm = Literal["adam", "muon"]
Schedule = Literal["constant", "cosine"]


@dataclass(frozen=True, config=DOCUMENTED)
class OptimiserSettings:
    """Algorithm, batch, learning rate and what smooths it."""

    algorithm: Algorithm = "muon"
    """Adam, as in the paper, or Muon for the inner convolutions and Adam for the other weights. Muon has a
    smaller error after the same training (notebook/experiments.md)."""
    learning_rate: Positive = 1e-3
    """Step size. With both algorithms, the root mean square of a weight's step is about a fifth of it; the
    first steps of Adam are as large as it. The paper: 1e-4."""
    batch_size: WholeCount = 16
    """Scenes of one training step, shared by all processes of a run."""
    schedule: Schedule = "cosine"
    """Learning rate: constant, as in the paper, or down to 0 along half a cosine by the last epoch."""
    warm_up_epochs: NotNegative = 0.5
    """Epochs in which the learning rate grows from 0; may be a fraction."""
    clip_norm: NotNegative = 1.0
    """Largest norm of the gradient; a longer one is scaled down to it. 0: no limit."""
    ema_decay: Annotated[float, Field(ge=0, lt=1)] = 0.99
    """Decay per step of the average of the weights that is validated and kept; 0: no average."""
