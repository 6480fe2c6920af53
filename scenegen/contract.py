"""The contract of every JSON and TOML file: strict types, the shared value types, one sentence for an error.

Each dataclass that is stored in a file has `STRICT` as pydantic configuration. `checked` parses its text.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from scenegen.night_error import NightError

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

WholeCount = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
_Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # metres or degrees, also beyond those of presets
FARTHEST_M = 1000
Vector = tuple[_Coordinate, _Coordinate, _Coordinate]
Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Length = Annotated[float, Field(ge=1e-4, le=1000)]  # metres; float32 coordinates cannot hold thinner objects
Extent = tuple[Length, Length, Length]
Location = tuple[Metres, Metres, Metres]
Rotation = tuple[Degrees, Degrees, Degrees]
Reflectance = Annotated[float, Field(ge=0, le=1)]
Roughness = Annotated[float, Field(gt=0, le=1)]
MIN_FOV_DEG, MAX_FOV_DEG = 1.0, 170.0
FieldOfView = Annotated[float, Field(ge=MIN_FOV_DEG, le=MAX_FOV_DEG)]  # degrees
_MOST_CHARACTERS = 100  # of a value in a message


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
        return adapter.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
            problem = f"unknown key {key}"
        elif first["type"] == "missing":
            problem = f"key {key} is missing"
        elif first["type"] == "value_error" and not first["loc"]:
            problem = first["msg"].removeprefix("Value error, ")  # of several keys together, which it names
        else:
            given = f" (got {_shortened(first['input'])})" if not isinstance(first["input"], dict) else ""
            problem = f"{key}: {first['msg'].removeprefix('Value error, ')}{given}"
        raise refusal(f"{origin}: {problem}") from None


def _shortened(value: object) -> str:
    """A value as text for a message; the middle of a long one is left out."""
    text, half = repr(value), _MOST_CHARACTERS // 2
    return text if len(text) <= _MOST_CHARACTERS else f"{text[:half]}...{text[-half:]}"
