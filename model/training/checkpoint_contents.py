"""Checks of what a checkpoint holds, before a training takes it over.

The file is whole and of this run, as its checksum says, but whoever made it may have put anything into it.
Each function raises `ContentsError` for a value that no training can have written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from model.run_folder.history import EpochRecord
from model.run_folder.weights import misfit
from model.training.loss_watch import EXPLODED


class ContentsError(ValueError):
    """A part of a checkpoint that does not belong to this training."""


def checked_whole(value: Any, least: int, most: int, name: str) -> int:
    """A whole number within bounds."""
    if type(value) is not int or not least <= value <= most:
        raise ContentsError(f"{name} must be a whole number from {least} to {most}")
    return value


def checked_number(value: Any, least: float, most: float, name: str) -> float:
    """A finite number within bounds."""
    if type(value) is not float or not least <= value <= most or not math.isfinite(value):
        raise ContentsError(f"{name} must be a number from {least:g} to {most:g}")
    return value


def checked_keys(value: Any, expected: Mapping[str, Any] | frozenset[str], name: str) -> dict[str, Any]:
    """A dictionary with these keys and no others."""
    if not isinstance(value, dict) or value.keys() != set(expected):
        raise ContentsError(f"{name} must have the keys {', '.join(sorted(expected)) or '(none)'}")
    return value


def checked_tensors(
    value: Any, expected: Mapping[str, Tensor], name: str, *, finite: bool = True
) -> dict[str, Tensor]:
    """Tensors with the names, shapes and number types of `expected`; not NaN, and finite if `finite`."""
    problem = misfit(value, expected)
    if problem:
        raise ContentsError(f"{name}: {problem}")
    for key, tensor in value.items():
        if not bool((tensor.isfinite() if finite else ~tensor.isnan()).all()):
            raise ContentsError(f"{name}: {key} is not finite")
    return dict(value)


def checked_history(value: Any) -> list[EpochRecord]:
    """Records of the epochs 1, 2, 3, ..., perhaps after that of the start, 0."""
    if not isinstance(value, list):
        raise ContentsError("history must be a list")
    history = [EpochRecord(**record) for record in value]
    for epoch, record in enumerate(history, start=0 if history and history[0].epoch == 0 else 1):
        if not record.is_possible or record.epoch != epoch:
            raise ContentsError(f"history: epoch {epoch} has an impossible record")
    return history


def checked_position(value: Any, batches_an_epoch: int, scenes: int) -> tuple[int, float]:
    """Finished batches of the current epoch, and the sum of their losses over its scenes."""
    position = checked_keys(value, frozenset({"batches", "loss_total"}), "position")
    batches = checked_whole(position["batches"], 0, batches_an_epoch, "position.batches")
    most = EXPLODED * scenes if batches else 0.0
    return batches, checked_number(position["loss_total"], -most, most, "position.loss_total")


def checked_adam(
    value: Any, own: Mapping[str, Any], parameters: Sequence[Tensor], steps: int
) -> dict[str, Any]:
    """State of Adam for `parameters` after `steps` steps; `own` is the state of one that has not begun."""
    moments = _checked_moments(value, own, "adam", has_begun=steps > 0)
    for index, parameter in zip(moments, parameters, strict=False):
        like = {"step": torch.zeros(()), "exp_avg": parameter, "exp_avg_sq": parameter}
        entry = checked_tensors(moments[index], like, f"adam.state.{index}", finite=False)
        done = float(entry["step"])
        if not (done.is_integer() and 0 <= done <= steps) or bool((entry["exp_avg_sq"] < 0).any()):
            raise ContentsError(f"adam.state.{index} has impossible values")
    return {"state": moments, "param_groups": own["param_groups"]}


def checked_muon(value: Any, own: Mapping[str, Any], parameters: Sequence[Tensor]) -> dict[str, Any]:
    """State of Muon for `parameters`; `own` is the state of one that has not begun."""
    moments = _checked_moments(value, own, "muon", has_begun=True)
    for index, parameter in zip(moments, parameters, strict=False):
        checked_tensors(moments[index], {"momentum": parameter}, f"muon.state.{index}")
    return {"state": moments, "param_groups": own["param_groups"]}


def _checked_moments(value: Any, own: Mapping[str, Any], name: str, *, has_begun: bool) -> dict[int, Any]:
    """What an optimiser knows of each weight, by its number, in ascending order; its settings are `own`."""
    found = checked_keys(value, frozenset({"state", "param_groups"}), name)
    (group,), (own_group,) = found["param_groups"], own["param_groups"]
    checked_keys(group, own_group, f"{name}.param_groups")
    checked_number(group["lr"], 0.0, math.inf, f"{name}.lr")
    for key in own_group.keys() - {"lr"}:
        if not _is_same(group[key], own_group[key]):
            raise ContentsError(f"{name}: {key} is not that of this training")
    moments = found["state"]
    begun = own_group["params"] if has_begun else []
    if not isinstance(moments, dict) or moments.keys() != set(begun):
        raise ContentsError(f"{name}.state must have an entry for each weight that is trained")
    return {index: moments[index] for index in begun}


def checked_scaler(value: Any, own: Mapping[str, Any]) -> dict[str, Any]:
    """State of the gradient scaler; `own` is the state of one that has not begun."""
    found = checked_keys(value, own, "scaler")
    if found:
        checked_number(found["scale"], 1e-300, math.inf, "scaler.scale")
        checked_whole(found["_growth_tracker"], 0, own["growth_interval"], "scaler._growth_tracker")
    for name in own.keys() - {"scale", "_growth_tracker"}:
        if not _is_same(found[name], own[name]):
            raise ContentsError(f"scaler: {name} is not that of this training")
    return found


def _is_same(found: Any, own: Any) -> bool:
    """Whether a setting of the optimiser is our own; a foreign object may compare as equal, or not at all."""
    return type(found) is type(own) and repr(found) == repr(own)
