"""Small pieces of the report page; whatever text goes in comes out escaped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any, NamedTuple


class Section(NamedTuple):
    """A part of the page: `name` is its anchor, `lede` says how to read it, `body` is HTML."""

    name: str
    title: str
    lede: str
    body: str

    @property
    def link(self) -> str:
        """Its line in the table of contents."""
        return f'<a href="#{self.name}">{escape(self.title)}</a>'

    @property
    def html(self) -> str:
        """The section as HTML."""
        return (
            f'<section id="{self.name}"><h2>{escape(self.title)}</h2>\n'
            f'<p class="lede">{escape(self.lede)}</p>\n{self.body}\n</section>'
        )


def note(text: str) -> str:
    """A quiet sentence."""
    return f'<p class="note">{escape(text)}</p>'


def grid(parts: Iterable[str], columns: str) -> str:
    """Parts beside one another: `columns` is ``two`` or ``three`` in rows, or ``flow``."""
    return f'<div class="{columns}">{"".join(f"<div>{part}</div>" for part in parts)}</div>'


def tile(name: str, value: str, beside: str) -> str:
    """A number that should be seen first."""
    texts = (("name", name), ("value", value), ("beside", beside))
    return (
        f'<div class="tile">{"".join(f"<p class={kind!r}>{escape(text)}</p>" for kind, text in texts)}</div>'
    )


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    words: int = 1,
    shares: Mapping[int, float] | None = None,
    share_column: int = 0,
) -> str:
    """A table whose first `words` columns are words, the others numbers.

    A row whose first word is another than the row's before begins a block. `shares` are bars from 0 to 1
    behind the numbers of `share_column`, by row.
    """
    lines, before = [], None
    for place, row in enumerate(rows):
        begins = words > 1 and before is not None and row[0] != before
        cells = []
        for column, text in enumerate(row):
            shown = "" if words > 1 and column == 0 and text == before else escape(text)
            cells.append(
                f"<td{_cell_style(column, words, share_column, (shares or {}).get(place))}>{shown}</td>"
            )
        lines.append(f"<tr{' class=begins' if begins else ''}>{''.join(cells)}</tr>")
        before = row[0]
    top = "".join(
        f'<th scope="col"{_cell_style(column, words, share_column, None)}>{escape(text)}</th>'
        for column, text in enumerate(head)
    )
    kind = ' class="blocks"' if words > 1 else ""
    return (
        f'<div class="wide"><table{kind}><thead><tr>{top}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def settings(values: Mapping[str, Any]) -> str:
    """A table of names and values."""
    rows = "".join(
        f'<tr><td class="word">{escape(name.replace("_", " "))}</td><td>{escape(_text(value))}</td></tr>'
        for name, value in values.items()
    )
    return f'<div class="wide"><table class="settings"><tbody>{rows}</tbody></table></div>'


def _cell_style(column: int, words: int, share_column: int, share: float | None) -> str:
    if column < words:
        return ' class="word"'
    if column == share_column and share is not None:
        return f' class="share" style="--part:{100 * min(max(share, 0.0), 1.0):.0f}%"'
    return ""


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{name.replace('_', ' ')}: {_text(part)}" for name, part in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_text(part) for part in value) or "none"
    return "not set" if value is None else str(value)
