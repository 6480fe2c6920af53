"""Outcomes that say themselves in sentences, as a notebook and a Python shell show them."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Protocol


class Told(Protocol):
    """An outcome with sentences; a class that derives from it shows them in a notebook.

    A dataclass needs ``repr=False`` to have the short text of a shell, and not all of its numbers.
    """

    @property
    def sentences(self) -> Sequence[str]:
        """The outcome as text."""

    def __repr__(self) -> str:
        first, *others = self.sentences
        return f"{type(self).__name__}: {first}\n{len(others)} more in sentences"

    def _repr_html_(self) -> str:
        return "<ul>" + "".join(f"<li>{html.escape(each)}</li>" for each in self.sentences) + "</ul>"
