"""The contract of every JSON and TOML file: strict types, and one sentence for an error.

Each dataclass that is stored in a file has `STRICT` as pydantic configuration. `checked` parses its text.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, from_json

from disk.night_error import NightError
from disk.plain_file import decoded

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
DOCUMENTED = ConfigDict(**STRICT, use_attribute_docstrings=True)  # the text below a field describes it

_QUOTE = "'"
_MOST_CHARACTERS = 100  # of a value in a message
# What a value must be, by pydantic's name of the problem, where its own words name types of Python.
_WANTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list of values in [ ]",
    "list_type": "a list of values in [ ]",
    "dict_type": "a table of keys and values",
    "dataclass_type": "a table of keys and values",
    "model_attributes_type": "a table of keys and values",
}


class ContractError(NightError):
    """A file whose contents break its contract: not JSON, an unknown or missing key, an impossible value."""


def checked(
    adapter: TypeAdapter[Any], text: str | bytes, origin: str, refusal: type[NightError] = ContractError
) -> Any:
    """Parse JSON text strictly and report only the first problem.

    Parameters
    ----------
    adapter : pydantic adapter of the expected type.
    text : JSON, as text or as UTF-8 bytes.
    origin : name of the file, for the message.
    refusal : class of the error that is raised.

    Returns
    -------
    The object that `adapter` describes.

    Raises
    ------
    ContractError, or `refusal` where it is given : one sentence that names the file, the key and the problem.
    """
    try:
        text = decoded(text) if isinstance(text, bytes) else text
    except UnicodeError as error:
        raise refusal(f"{origin} cannot be read: {error}") from None
    try:
        return adapter.validate_json(text)
    except ValidationError as error:
        raise refusal(f"{origin}: {_problem(error.errors()[0], text)}") from None


def checked_data(
    adapter: TypeAdapter[Any], data: Mapping[str, Any], origin: str, refusal: type[NightError]
) -> Any:
    """`checked` for plain data, such as the contents of a TOML file."""
    try:
        text = json.dumps(data, default=str)
    except (ValueError, RecursionError) as error:  # hexadecimal numbers too long, and tables too deep
        raise refusal(f"{origin}: {error}") from None
    return checked(adapter, text, origin, refusal)


def _problem(error: ErrorDetails, text: str) -> str:
    """What is wrong with a key of the text, and what it must be."""
    kind, place = error["type"], _place_in_text(error, text)
    key = ".".join(str(part) for part in place) or "the file"
    if kind.startswith("union_tag_"):
        said = error["ctx"]
        tag = f"{key}.{said['discriminator'].strip(_QUOTE)}"
        if "tag" not in said:
            return f"key {tag} is missing"
        return f"{tag} must be one of {said['expected_tags']} (got {said['tag']!r})"
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown key {key}"
    if kind == "missing" and place and isinstance(place[-1], int):
        return f"{'.'.join(str(part) for part in place[:-1])} has too few values: only {place[-1]}"
    if kind == "missing":
        return f"key {key} is missing"
    message = error["msg"].removeprefix("Value error, ")
    if message.startswith("must be "):  # of `disk.quantities`
        return f"{key} {message}"
    if kind == "value_error" and not place:
        return message  # of several keys together, which it names
    if kind in ("too_short", "too_long"):
        limits, side = error["ctx"], "min" if kind == "too_short" else "max"
        bound = f"{'at least' if side == 'min' else 'at most'} {limits[f'{side}_length']}"
        return f"{key} has {limits['actual_length']} values instead of {bound}"
    given = f" (got {_shortened(error['input'])})" if not isinstance(error["input"], dict) else ""
    if kind in _WANTED:
        return f"{key} must be {_WANTED[kind]}{given}"
    if message.startswith("Input should be "):
        return f"{key} must be {message.removeprefix('Input should be ')}{given}"
    return f"{key}: {message}{given}"


def _place_in_text(error: ErrorDetails, text: str) -> tuple[int | str, ...]:
    """Keys and indices that lead to the error: those of pydantic without the kinds of tables and values."""
    if error["type"] == "json_invalid":
        return error["loc"]
    data: Any = from_json(text)
    place: list[int | str] = []
    for part in error["loc"]:
        if (
            isinstance(data, dict)
            and part not in data
            and (part in data.values() or error["type"] != "missing")
        ):
            continue
        if isinstance(part, str) and isinstance(data, int | float | str | list):
            continue
        place.append(part)
        try:
            data = data[part]
        except (IndexError, KeyError, TypeError):
            data = None
    return tuple(place)


def _shortened(value: object) -> str:
    """A value as text for a message; the middle of a long one is left out."""
    text, half = repr(value), _MOST_CHARACTERS // 2
    return text if len(text) <= _MOST_CHARACTERS else f"{text[:half]}...{text[-half:]}"
