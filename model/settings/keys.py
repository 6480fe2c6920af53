"""The keys of settings as they stand in TOML and on the command line, such as ``target.kind``."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, Final, get_args

from pydantic.fields import FieldInfo

from disk import PresetError

KIND: Final = "kind"  # the key that says which other keys a table has
_NEAREST: Final = 3
_LONGEST: Final = 100  # characters of a key to which others are compared
_DEEPEST: Final = 8


def merged(before: Mapping[str, Any], changes: Mapping[str, Any], levels: int = _DEEPEST) -> dict[str, Any]:
    """Plain data with changes, table by table; a table whose ``kind`` changes is replaced as a whole.

    Parameters
    ----------
    levels : of tables that are merged. Deeper ones, of which settings have none, are replaced.
    """
    result = dict(before)
    for key, value in changes.items():
        old = before.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            stays = value.get(KIND, old.get(KIND)) == old.get(KIND)
            result[key] = merged(old, value, levels - 1) if stays and levels else value
        else:
            result[key] = value
    return result


def tables(values: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data of values by their keys, in any order: of ``network.width`` a table ``network``."""
    result: dict[str, Any] = {}
    for key, value in values.items():
        *groups, name = key.split(".")
        table = result
        for group in groups:
            if not isinstance(table.get(group), dict):
                table[group] = {}
            table = table[group]
        both = isinstance(value, dict) and isinstance(table.get(name), dict)
        table[name] = table[name] | value if both else value
    return result


def fields_of(table: type) -> dict[str, FieldInfo]:
    """Type, bounds, default and description of each key of a class of settings."""
    fields: dict[str, FieldInfo] = table.__pydantic_fields__  # type: ignore[attr-defined]
    return fields


def tables_of(field: FieldInfo) -> tuple[type, ...]:
    """The classes of which a value may be: none for a number, several for a table with kinds."""
    choices = get_args(field.annotation) or (field.annotation,)
    return tuple(each for each in choices if isinstance(each, type) and is_dataclass(each))


def all_keys(table: type, prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Every key of a class of settings, tables too, and of the tables in it, of all kinds."""
    for name, field in fields_of(table).items():
        yield f"{prefix}{name}", field
        for each in tables_of(field):
            yield from all_keys(each, f"{prefix}{name}.")


def wrong_key(table: type, data: Mapping[str, Any]) -> str | None:
    """The first key in `data` that is unknown, or not of its kind of table, in words; None without one."""
    return _wrong_key(dict(all_keys(table)), (table,), data, "")


def _wrong_key(
    known: Mapping[str, FieldInfo], choices: tuple[type, ...], data: Mapping[str, Any], prefix: str
) -> str | None:
    """`wrong_key` in a table that may be of several classes."""
    kinds = {fields_of(each)[KIND].default: each for each in choices} if len(choices) > 1 else {}
    table = kinds.get(data[KIND]) if kinds and isinstance(data.get(KIND), str) else choices[0]
    if table is None or (kinds and KIND not in data):
        return None  # the check of the values says so
    for name, value in data.items():
        key = f"{prefix}{name}"
        field = fields_of(table).get(name)
        if field is None:
            others = [kind for kind, each in kinds.items() if name in fields_of(each)]
            if others:
                place = f"{prefix}{KIND}"
                return f"{key} goes with {place} {' or '.join(others)}, and it is {data[KIND]}: leave it out"
            return f"unknown key {key}{_nearest(key, known)}"
        inner = tables_of(field)
        if inner and isinstance(value, dict):
            wrong = _wrong_key(known, inner, value, f"{key}.")
            if wrong:
                return wrong
    return None


def _nearest(key: str, known: Mapping[str, FieldInfo]) -> str:
    """The keys that may be meant, as the end of a sentence."""
    if len(key) > _LONGEST:
        return ""
    last = {name: name.rsplit(".", 1)[-1] for name in known}
    near = difflib.get_close_matches(key, known, n=_NEAREST)
    alike = difflib.get_close_matches(key.rsplit(".", 1)[-1], set(last.values()), n=_NEAREST)
    near += [name for word in alike for name in known if last[name] == word and name not in near]
    return f": the nearest are {', '.join(near[:_NEAREST])}" if near else ""


def parsed(assignment: str) -> tuple[str, Any]:
    """Key and value of ``group.key=value``; the value is one of TOML, or a word without quotes.

    Raises
    ------
    PresetError : there is no key, or the value is not TOML.
    """
    key, equals, text = assignment.partition("=")
    if not equals or not all(key.strip().split(".")):
        raise PresetError(f"{assignment!r} is no setting: write it like network.width=32")
    try:
        value = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        value = {"value": text.strip()}
    if len(value) != 1 or not text.strip():
        raise PresetError(f"{assignment!r} is no setting: write it like network.width=32")
    return key.strip(), value["value"]
