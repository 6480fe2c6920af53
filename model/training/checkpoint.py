"""``checkpoint.pt`` of a run folder: the state from which a training resumes, also within an epoch.

It is a file of `torch.save`, which is a ZIP archive. The archive's comment is a `label_text`: the id of the
run and the file's own checksum.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch

from disk import whole_file
from disk.checksums import label_text, labelled
from disk.plain_file import read_plain
from model.run_folder.run_config import RUN_SCHEMA, RunConfig, RunError
from model.run_folder.weights import least_bytes, refuse_other_label

CHECKPOINT_FILE: Final = "checkpoint.pt"
KEYS: Final = frozenset({"network", "optimisation", "best", "position", "history", "window_rows"})
_AGAIN: Final = "the run cannot be resumed; use its best weights as they are, or train again from the start"
_COMMENT_LENGTH: Final = 2  # bytes at the end of an archive without a comment
_COPIES: Final = 6  # of the weights: network, average, best, two moments of Adam; and one to spare
_MOST_OTHER: Final = 2**28  # bytes


def save_checkpoint(folder: Path, state: Mapping[str, Any], run_id: str) -> None:
    """Write ``checkpoint.pt``; `state` has the keys KEYS and contains tensors, numbers and text only.

    Raises
    ------
    OSError : the file cannot be written.
    """
    content = labelled(_packed(state, label_text(run_id).encode()))
    with whole_file(folder / CHECKPOINT_FILE) as partial:
        partial.write_bytes(content)


def _packed(state: Mapping[str, Any], comment: bytes) -> bytes:
    """The archive of a state, with a comment."""
    stream = io.BytesIO()  # where PyTorch cannot fail: for a full disk it has no exception of its own
    torch.save({"schema_version": RUN_SCHEMA, **state}, stream)
    with stream.getbuffer() as archive:
        length = len(comment).to_bytes(_COMMENT_LENGTH, "little")
        return b"".join((archive[:-_COMMENT_LENGTH], length, comment))


def refuse_short_checkpoint(folder: Path, config: RunConfig) -> None:
    """`RunError` if ``checkpoint.pt`` is too short for the network that ``run.json`` describes."""
    file, least = folder / CHECKPOINT_FILE, least_bytes(config)
    if file.stat().st_size < least:
        raise RunError(
            f"{file} is damaged, or the checkpoint of another network: it has {file.stat().st_size} bytes, "
            f"and the network of run.json takes at least {least}: {_AGAIN}"
        )


def load_checkpoint(folder: Path, config: RunConfig, weights_bytes: int) -> dict[str, Any] | None:
    """Read ``checkpoint.pt`` into memory; None if it does not exist.

    The checksum is compared first. PyTorch reads the file with ``weights_only=True``, so nothing in it is
    executed. The types of the parts are not checked here (`TrainingState.restore`).

    Parameters
    ----------
    config : contents of the run's ``run.json``.
    weights_bytes : size of the network's weights; a checkpoint has several copies of them.

    Raises
    ------
    RunError : the file is damaged, belongs to another run, or is no checkpoint of this schema version.
    """
    file = folder / CHECKPOINT_FILE
    if not file.is_file():
        return None
    try:
        content = read_plain(file, _COPIES * weights_bytes + _MOST_OTHER)
    except OSError as error:
        raise RunError(f"{file} cannot be read ({error.strerror}): {_AGAIN}") from None
    refuse_other_label(content, file, config, _AGAIN)
    state = _unpacked(content, file)
    schema = state.get("schema_version") if isinstance(state, dict) else None
    if type(schema) is not int or schema != RUN_SCHEMA:
        raise RunError(f"{file} is no checkpoint of schema version {RUN_SCHEMA}: {_AGAIN}")
    missing = KEYS - state.keys()
    if missing:
        raise RunError(f"{file} lacks {' and '.join(sorted(missing))}: {_AGAIN}")
    return {key: state[key] for key in KEYS}


def _unpacked(content: bytes, file: Path) -> Any:
    """What `torch.save` packed; `RunError` if it is anything else."""
    try:
        _refuse_compressed(content)
        with warnings.catch_warnings():  # PyTorch warns of pickles before it refuses them
            warnings.simplefilter("ignore")
            return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except Exception:  # a foreign archive or pickle raises exceptions of any kind
        raise RunError(f"{file} is damaged or no checkpoint: {_AGAIN}") from None


def _refuse_compressed(content: bytes) -> None:
    """`ValueError` for an archive that is larger unpacked than packed; those of PyTorch are not."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = archive.infolist()
    are_stored = all(file.compress_type == zipfile.ZIP_STORED for file in files)
    if not are_stored or sum(file.file_size for file in files) > len(content):
        raise ValueError("a compressed archive")
