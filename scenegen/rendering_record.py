"""How a dataset was rendered: ``renders/rendering.json``.

``dataset.json`` says how the scenes were made and belongs to ``night-gen``; this file belongs to
``night-render``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from disk.contract import STRICT, checked
from disk.path_like import PathLike
from disk.plain_file import read_plain
from disk.quantities import WholeCount
from disk.whole_writing import write_text

RENDERING_FILE = "rendering.json"


@dataclass(frozen=True, config=STRICT)
class RenderingRecord:
    """How the scenes of a dataset are rendered, and how well.

    Attributes
    ----------
    method, product, max_bounces : as given to ``night-render``.
    options : of the method, by name.
    width, height : image size, pixels.
    packages : versions of the programs that rendered.
    scene_count : how many scenes are rendered with these settings.
    hidden_error_median, hidden_error_max : over scenes, the method's estimate of the error of the hidden
        phasors relative to them; None when it has none.
    """

    method: str
    product: str
    max_bounces: int
    options: dict[str, int | float | None]
    width: WholeCount
    height: WholeCount
    packages: dict[str, str]
    scene_count: Annotated[int, Field(ge=0)]
    hidden_error_median: float | None
    hidden_error_max: float | None
    schema_version: Literal[1] = 1


def read_rendering_record(renders: PathLike) -> RenderingRecord | None:
    """Read the record in a folder of renders; None when there is none.

    Raises
    ------
    ContractError : the file is damaged; the message names the key.
    OSError : the file cannot be read.
    """
    file = Path(renders, RENDERING_FILE)
    try:
        text = read_plain(file)
    except FileNotFoundError:
        return None
    record: RenderingRecord = checked(TypeAdapter(RenderingRecord), text, str(file))
    return record


def write_rendering_record(renders: PathLike, record: RenderingRecord) -> None:
    """Write ``rendering.json``, complete or not at all."""
    text = TypeAdapter(RenderingRecord).dump_json(record, indent=2).decode()
    write_text(Path(renders, RENDERING_FILE), text + "\n")
