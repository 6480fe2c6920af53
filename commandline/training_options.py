"""Options of ``night-train`` that are made of settings: the twenty or so that people set, and ``--set``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from types import NoneType
from typing import Annotated, Any, Final, Literal, TypeVar, get_args, get_origin

import click
from pydantic.fields import FieldInfo

from commandline.options import Megahertz, Number, Sensor, option, options
from itof.sensor.settings import SensorSettings
from model.settings.keys import KIND, all_keys, parsed, tables
from model.settings.train_settings import TrainSettings

_Command = TypeVar("_Command", bound=Callable[..., None])

# Options by heading, with the setting that each one changes; the others are changed with --set.
SHOWN: Final[Mapping[str, Mapping[str, str]]] = {
    "Input": {
        "frequencies": "input.frequencies_hz",
        "channels": "input.channels.kind",
        "reference": "input.channels.reference",
        "sensor": "augmentation.camera.sensor",
    },
    "Network": {
        "width": "network.width",
        "levels": "network.levels",
        "block": "network.block",
        "target": "target.kind",
    },
    "Training": {
        "learning-rate": "optimiser.learning_rate",
        "batch-size": "optimiser.batch_size",
        "max-epochs": "run.max_epochs",
        "train-scenes": "run.train_scenes",
        "seed": "run.seed",
    },
    "Machine": {
        "device": "run.device",
        "progress": "run.progress",
    },
}


def given_settings(chosen: Mapping[str, Any], assignments: tuple[str, ...]) -> dict[str, Any]:
    """Settings that the command line gives, as plain data for `settings_from_dict`; --set comes last.

    Parameters
    ----------
    chosen : values of the options `TRAINING` by the names of their parameters; None for those not given.
    assignments : values of --set.

    Raises
    ------
    PresetError : an assignment is not of the form ``group.key=value``.
    """
    values = {key: chosen[_parameter(key)] for key in _KEYS}
    given = {key: value for key, value in values.items() if value is not None}
    plain = {k: asdict(value) if isinstance(value, SensorSettings) else value for k, value in given.items()}
    return tables(plain | dict(map(parsed, assignments)))


def _parameter(key: str) -> str:
    """Name of the parameter of an option."""
    return key.replace(".", "_")


def _training_option(section: str, flag: str, key: str) -> Callable[[_Command], _Command]:
    """The option of a setting; not given, it is None."""
    table, _, name = key.rpartition(".")
    fields = _fields_at(key)
    words = f"--{flag}/--no-{flag}" if fields[0].annotation is bool else f"--{flag}"
    return option(
        section,
        _parameter(key),
        words,
        type=_option_type(fields),
        default=None,
        help=_first_sentence(_fields_at(table if name == KIND else key)[0]),
    )


def _fields_at(key: str) -> list[FieldInfo]:
    """The fields of a key, one for each kind of table that has it."""
    return [field for each, field in all_keys(TrainSettings) if each == key]


def _first_sentence(field: FieldInfo) -> str:
    text = " ".join((field.description or "").split())
    return text if ". " not in text else f"{text.split('. ')[0]}."


def _option_type(fields: list[FieldInfo]) -> click.ParamType:
    """The type of the option of a setting, with its bounds; `fields` are those of the kinds that have it."""
    field = fields[0]
    if get_origin(field.annotation) is Literal:
        return click.Choice([*dict.fromkeys(word for each in fields for word in get_args(each.annotation))])
    if field.annotation is bool:
        return click.BOOL
    number, *metadata = _number_of(field)
    if number is SensorSettings:
        return Sensor()
    if number not in (int, float):
        return Megahertz()
    names = ("ge", "gt", "least", "le", "lt", "most")
    bounds = {name: getattr(item, name) for item in metadata for name in names if hasattr(item, name)}
    kind = click.IntRange if number is int else Number
    return kind(
        min=bounds.get("ge", bounds.get("gt", bounds.get("least"))),
        max=bounds.get("le", bounds.get("lt", bounds.get("most"))),
        min_open="gt" in bounds,
        max_open="lt" in bounds,
    )


def _number_of(field: FieldInfo) -> list[Any]:
    """The type of a setting that may be None without that, then what bounds it."""
    wanted = [kind for kind in get_args(field.annotation) if kind is not NoneType]
    if len(wanted) != 1:
        return [field.annotation, *field.metadata]
    number, *marks = get_args(wanted[0]) if get_origin(wanted[0]) is Annotated else (wanted[0],)
    return [number, *(item for mark in marks for item in getattr(mark, "metadata", [mark]))]


_KEYS: Final = tuple(key for flags in SHOWN.values() for key in flags.values())
TRAINING = options(
    *(_training_option(section, flag, key) for section, flags in SHOWN.items() for flag, key in flags.items())
)
SET = option(
    "Settings",
    "--set",
    "assignments",
    multiple=True,
    metavar="GROUP.KEY=VALUE",
    help="Change any setting (docs/reference/settings.md), such as optimiser.clip_norm=0; may be repeated.",
)
