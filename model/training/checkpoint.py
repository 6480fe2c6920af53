"""``checkpoint.pt`` of a run folder: the state from which a training resumes, also within an epoch."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from model.run_folder import RUN_SCHEMA, RunError
from scenegen import whole_file

CHECKPOINT_FILE = "checkpoint.pt"
KEYS = frozenset({"network", "optimisation", "best", "position", "history", "window_rows"})


def save_checkpoint(folder: Path, state: Mapping[str, Any]) -> None:
    """Write ``checkpoint.pt``; `state` has the keys KEYS and contains tensors, numbers and text only.

    Raises
    ------
    RunError : the file cannot be written.
    """
    with whole_file(folder / CHECKPOINT_FILE) as partial:
        try:
            torch.save({"schema_version": RUN_SCHEMA, **state}, partial)
        except RuntimeError as error:  # PyTorch has no other for a full disk
            reason = str(error).splitlines()[0]
            raise RunError(
                f"{folder / CHECKPOINT_FILE} cannot be written ({reason}): is the disk full?"
            ) from None


def load_checkpoint(folder: Path) -> dict[str, Any] | None:
    """Read ``checkpoint.pt`` into memory; None if it does not exist.

    The file is read with ``weights_only=True``, so nothing in it is executed.

    Raises
    ------
    RunError : the file is damaged, or it is not a checkpoint of this schema version.
    """
    file = folder / CHECKPOINT_FILE
    if not file.is_file():
        return None
    try:
        with warnings.catch_warnings():  # PyTorch warns of pickles before it refuses them
            warnings.simplefilter("ignore", UserWarning)
            state = torch.load(file, map_location="cpu", weights_only=True)
    except OSError as error:
        raise RunError(f"{file} cannot be read: {error.strerror or error}") from None
    except (RuntimeError, EOFError, KeyError, ValueError, pickle.UnpicklingError):
        raise RunError(f"{file} is damaged or no checkpoint: train again from the start") from None
    if not isinstance(state, dict) or state.get("schema_version") != RUN_SCHEMA:
        raise RunError(f"{file} is no checkpoint of schema version {RUN_SCHEMA}: train again from the start")
    missing = KEYS - state.keys()
    if missing:
        raise RunError(f"{file} lacks {' and '.join(sorted(missing))}: train again from the start")
    return state
