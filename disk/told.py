"""Outcomes that say themselves in sentences, as a notebook shows them."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Protocol


class Told(Protocol):
    """An outcome with sentences; a class that derives from it shows them in a notebook."""

    @property
    def sentences(self) -> Sequence[str]:
        """The outcome as text."""

    def _repr_html_(self) -> str:
        return "<ul>" + "".join(f"<li>{html.escape(each)}</li>" for each in self.sentences) + "</ul>"
