"""How figures look: sizes of print, colours that the colour-blind can tell apart, PNG and PDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rmesh_nlp.io.files import write_whole

TWO_COLUMNS = 7.0
"""Width of a printed page's text in inches."""

LEGEND, KEY, COLUMNS = 92, 8, 5
"""Letters that fit into a legend of that width, those that the line before a name takes, and most columns."""

MAP = "viridis"
GRID_LINE = "0.25"
FOUNDATION = "0.45"

SETTINGS: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "lines.linewidth": 1.2,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,  # text stays text: publishers ask for it
}


@dataclass(frozen=True)
class Look:
    """Colour, line style and marker of one curve."""

    color: str
    linestyle: str
    marker: str
    size: float


# Okabe and Ito's palette; markers differ in size, so that curves on top of each other show
LOOKS = (
    Look("#000000", "--", "o", 4),
    Look("#D55E00", "-", "s", 7),
    Look("#0072B2", "-", "^", 5),
    Look("#009E73", "-.", "D", 3.5),
    Look("#CC79A7", ":", "v", 5),
    Look("#E69F00", "--", "P", 5),
    Look("#56B4E9", "-", "X", 5),
)


def look(position: int) -> Look:
    """The look of the curve at a position in its figure."""
    return LOOKS[position % len(LOOKS)]


def new_figure(width: float, height: float) -> Figure:
    """An empty figure that no window system knows of."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(
    figure: Figure, stem: Path, formats: Sequence[str] = ("png", "pdf"), settings: Any = None
) -> list[Path]:
    """Write the figure in each format and return the paths."""
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
    with rc_context(SETTINGS if settings is None else settings):
        if len(formats) > 1:  # the layout is found once, not for each format
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
        for path, kind in zip(paths, formats, strict=True):
            write_whole(path, partial(figure.savefig, format=kind))
    return paths


def legend_columns(names: Sequence[str]) -> int:
    """Columns of a legend that is not wider than a figure of two columns of print."""
    longest = max(map(len, names), default=1)
    return max(1, min(len(names), COLUMNS, LEGEND // (longest + KEY)))
