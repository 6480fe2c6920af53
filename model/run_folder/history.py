"""``history.csv`` of a run folder: losses and metrics of every epoch.

The last column of a line, ``crc32``, is the CRC-32 of all bytes of the file before it, as eight hexadecimal
digits. It also covers the lines above. Lines end with a carriage return and a line feed.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from disk import whole_file
from disk.plain_file import MOST_LIST_BYTES, read_plain
from model.run_folder.run_config import RunError

HISTORY_FILE: Final = "history.csv"
CHECK: Final = "crc32"
_END: Final = b"\r\n"


@dataclass(frozen=True)
class EpochRecord:
    """One line of ``history.csv``: losses, and metrics of the radial depth on the validation scenes.

    Attributes
    ----------
    epoch : from 1 on. 0 is the network that a training started from, before the first step; it has no loss of
        training, and `train_loss` is `validation_loss`.
    validation_uncertainty : the part of `validation_loss` that is the likelihood of the expected errors.
    """

    epoch: int
    learning_rate: float
    train_loss: float
    validation_loss: float
    validation_mae_cm: float
    validation_miou: float
    validation_uncertainty: float

    @property
    def is_possible(self) -> bool:
        """Whether a training can have written these values; for records that were read from a file."""
        numbers = {name: getattr(self, name) for name in COLUMNS if name != "epoch"}
        return (
            type(self.epoch) is int
            and all(type(number) is float and math.isfinite(number) for number in numbers.values())
            and all(numbers[name] >= 0 for name in numbers.keys() - _LOSSES)
            and self.validation_miou <= 1 + 1e-6  # and rounding
        )


def kept_epoch(validation_loss: Sequence[float], validation_uncertainty: Sequence[float]) -> int:
    """Index of the epoch whose weights are kept: the first with the smallest of `compared_losses`."""
    losses = compared_losses(validation_loss, validation_uncertainty)
    return losses.index(min(losses))


def compared_losses(validation_loss: Sequence[float], validation_uncertainty: Sequence[float]) -> list[float]:
    """Losses by which the epochs of a run are compared.

    They are those of mask and depth, so that the uncertainty does not change which weights are kept.
    """
    return [loss - part for loss, part in zip(validation_loss, validation_uncertainty, strict=True)]


# A likelihood of depths has negative logarithms.
_LOSSES: Final = {"train_loss", "validation_loss", "validation_uncertainty"}
COLUMNS: Final = tuple(field.name for field in fields(EpochRecord))


def write_history(folder: Path, history: Sequence[EpochRecord]) -> None:
    """Write ``history.csv``."""
    content = bytearray(",".join((*COLUMNS, CHECK)).encode() + _END)
    check = zlib.crc32(content)
    for record in history:
        line = "".join(f"{getattr(record, name)}," for name in COLUMNS).encode()
        check = zlib.crc32(line, check)
        line_end = f"{check:08x}".encode() + _END
        check = zlib.crc32(line_end, check)
        content += line + line_end
    with whole_file(folder / HISTORY_FILE) as partial:
        partial.write_bytes(content)


def read_history(run: Path) -> dict[str, list[float]]:
    """Columns of a run's ``history.csv`` by name; empty if the file does not exist.

    Those of earlier versions have no `validation_uncertainty`.

    Raises
    ------
    RunError : the file is damaged.
    """
    file = run / HISTORY_FILE
    try:
        return _columns(read_plain(file, MOST_LIST_BYTES))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RunError(f"{file} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RunError(
            f"{file} is damaged ({error}): write it again with night-train --resume, or delete it, which "
            "leaves the training curves out of the report"
        ) from None


def _columns(content: bytes) -> dict[str, list[float]]:
    """The columns without the checksums; `ValueError` says what is wrong."""
    head, *lines = content.split(_END)
    if not lines or lines.pop() != b"":
        raise ValueError("its last line has no end")
    names = tuple(head.decode("ascii", "replace").split(","))[:-1]
    if not head.endswith(f",{CHECK}".encode()) or names not in (COLUMNS, COLUMNS[:-1]):
        raise ValueError("its first line is not that of a history")
    check = zlib.crc32(head + _END)
    columns: dict[str, list[float]] = {name: [] for name in names} if lines else {}
    for number, line in enumerate(lines, start=1):
        values, comma, digits = line.rpartition(b",")
        check = zlib.crc32(values + comma, check)
        if digits != f"{check:08x}".encode():
            raise ValueError(f"the checksum of epoch {number} is wrong")
        check = zlib.crc32(digits + _END, check)
        for name, value in zip(names, values.split(b","), strict=True):
            columns[name].append(_finite(value))
        if columns["epoch"][-1] != number - (columns["epoch"][0] == 0):
            raise ValueError(f"epoch {number} is missing")
    return columns


def _finite(text: bytes) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{value} is no loss or metric")
    return value
