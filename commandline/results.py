"""What a command prints as its result: sentences for people, or one JSON object for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from commandline.sentences import printable
from commandline.streams import say

JSON = click.option(
    "--json", "as_json", is_flag=True, help="Print the result as one JSON object, and sentences on stderr."
)


def tell(sentences: Sequence[str], result: Mapping[str, Any] | Path, as_json: bool) -> None:
    """Print `sentences` on stdout, or, `as_json`, `result` there in one line and `sentences` on stderr.

    Parameters
    ----------
    result : plain data with finite numbers, or the JSON file that the command wrote.
    """
    text = "\n".join(printable(line) for sentence in sentences for line in sentence.split("\n"))
    if not as_json:
        click.echo(text)
        return
    if sentences:
        say(text)
    data = json.loads(result.read_text(encoding="utf-8")) if isinstance(result, Path) else dict(result)
    click.echo(json.dumps(data, allow_nan=False))
