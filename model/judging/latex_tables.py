"""The tables of a report for a paper: LaTeX, with the package booktabs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.metadata import version
from typing import Final

from disk.counted import counted
from model.judging.results import Report

# What CITATION.cff says.
REFERENCES: Final = """\
@inproceedings{caligiuri2024night,
  title = {{NIGHT} - Non-Line-of-Sight Imaging from Indirect Time of Flight Data},
  author = {Caligiuri, Matteo and Simonetto, Adriano and Zanuttigh, Pietro},
  booktitle = {European Conference on Computer Vision (ECCV) Workshops},
  year = {2024},
  note = {arXiv:2403.19376}
}

@misc{night,
  title = {{NIGHT}: seeing around a corner with an {iToF} camera},
  author = {{The NIGHT developers}},
  note = {Version VERSION}
}
""".replace("VERSION", version("night-nlos"))

_ESCAPED: Final = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
    }
)


def escaped(text: str) -> str:
    """A text, which may be a name that others gave, as LaTeX prints it on one line."""
    words = "".join(letter if letter.isprintable() else " " for letter in text).split()
    return " ".join(words).translate(_ESCAPED)


def latex_table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]], *, words: int) -> str:
    """A table; the first `words` columns are words, the others numbers and stand right."""
    lines = [" & ".join(escaped(cell) for cell in row) + r" \\" for row in (head, *rows)]
    columns = "l" * words + "r" * (len(head) - words)
    return "\n".join(
        (
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{caption}}}",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            lines[0],
            r"\midrule",
            *lines[1:],
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
        )
    )


def caption_of(report: Report, of: str) -> str:
    """What was judged, as a caption; `of` is what the table shows."""
    return escaped(f"{of}: {report.split} split, {counted(len(report.scenes), 'scene')}.")
