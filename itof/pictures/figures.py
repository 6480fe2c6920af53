"""What figures of depth maps share: their colours, their panels, and their files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from disk import whole_file
from itof import DepthMap
from itof.pictures.png import missing_letters_as_boxes, save_png

BACKGROUND = "0.88"  # grey of the pixels without object
LEAST_DEPTH_SPAN_M = 0.4  # with a smaller colour range, the noise of a flat object would look like relief
DOTS_PER_INCH = 150
_PAGE_COLOURS = {  # of matplotlib: ink, paper, BACKGROUND, grid, the sides of a box; and of the page
    "#000000": "currentColor",
    "#ffffff": "var(--page)",
    "#e0e0e0": "var(--nothing)",
    "#b0b0b0": "var(--baseline)",
    **dict.fromkeys(("#f2f2f2", "#e6e6e6", "#ececec"), "var(--card)"),
}


def write_figure(path: Path, figure: Figure) -> None:
    """Write a PNG file, whole or not at all."""
    with whole_file(path) as partial:
        save_png(figure, partial, DOTS_PER_INCH)


def write_pdf(path: Path, figure: Figure) -> None:
    """Write a PDF file for a paper, whole or not at all; the same figure gives the same bytes."""
    undated = dict.fromkeys(("CreationDate", "Creator", "Producer"))
    # Type 42 are TrueType fonts, which publishers ask for.
    with (
        whole_file(path) as partial,
        missing_letters_as_boxes(),
        rc_context({"pdf.fonttype": 42}),
    ):
        figure.savefig(partial, format="pdf", dpi=DOTS_PER_INCH, metadata=undated)


def svg_of(name: str, figure: Figure) -> str:
    """A figure as an element of a page, in the page's colours but for what its images show.

    Parameters
    ----------
    name : no other figure of the page has it.
    """
    content = StringIO()
    undated = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with missing_letters_as_boxes(), rc_context({"svg.hashsalt": name}):
        figure.savefig(content, format="svg", dpi=DOTS_PER_INCH, metadata=undated)
    svg = content.getvalue()
    # Styles and names of groups would be those of the whole page.
    others = r'<!--.*?-->|<style.*?</style>|(?<=<g) id="[^"]*"'
    svg = re.sub(others, "", svg[svg.index("<svg") :], flags=re.DOTALL)
    for colour, of_page in _PAGE_COLOURS.items():
        svg = svg.replace(colour, of_page)
    return svg


def depth_range(*views: DepthMap) -> tuple[float, float]:
    """Range of the depth colours, metres: that of the object in the first view that has one."""
    for view in views:
        if view.mask.any():
            depths_m = view.radial_depth_m[view.mask]
            near_m, far_m = float(depths_m.min()), float(depths_m.max())
            margin_m = max(0.1 * (far_m - near_m), (LEAST_DEPTH_SPAN_M - (far_m - near_m)) / 2)
            return near_m - margin_m, far_m + margin_m
    return 0.0, 1.0


def finish_panels(row: Sequence[Axes], *, titles: Sequence[str] = ()) -> None:
    """Remove the ticks of the panels of a row, colour their background, add their titles if there are any."""
    for axes in row:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(BACKGROUND)
    for axes, name in zip(row, titles, strict=False):
        axes.set_title(name, fontsize=11)


def plain(text: str) -> str:
    """Text for a picture; matplotlib would read a ``$`` in it as the start of a formula."""
    return text.replace("$", r"\$")
