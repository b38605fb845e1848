"""How figures look: widths and letters of print, colours safe for the colour-blind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.problem.units import bracketed

ONE_COLUMN, TWO_COLUMNS = 3.35, 7.0  # inches of one of two columns of a printed page, and of both
SMALLEST = 7.0  # points of the smallest letters, those of figures of one column
LABELS, ABOVE = 0.75, 0.62  # inches that labels take of a panel's width, title and labels of its height
FLAT = 0.6  # height over width of a body below which two of them stand one below the other on one column
TALLEST = 2.0  # height of a panel over its width, at most
LETTERS, KEY = 13.0, 8  # letters of a legend to the inch, and those that the line before a name takes
FORMATS = ("png", "pdf", "svg")
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
    "figure.dpi": 200,
    "pdf.fonttype": 42,  # text stays text: publishers ask for it
    "svg.fonttype": "none",  # the same in pages
}


@dataclass(frozen=True)
class Look:
    """Colour, line style and marker of one curve."""

    color: str
    linestyle: str
    marker: str
    size: float

    def line(self, scale: float = 1.0) -> dict[str, Any]:
        """What ``Axes.plot`` takes for a line with open markers, their sizes scaled."""
        pen = {"color": self.color, "linestyle": self.linestyle, "marker": self.marker}
        return {**pen, "markersize": scale * self.size, "markerfacecolor": "none"}


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
CONTACT, IN_CONTACT, NEUTRAL = "#009E73", "#D55E00", "#56B4E9"  # of the same palette


def look(position: int) -> Look:
    """The look of the curve at a position in its figure."""
    return LOOKS[position % len(LOOKS)]


@dataclass(frozen=True)
class Page:
    """One or two columns of a printed page, with letters of at least 7 points, and the format of figures."""

    columns: int = 2
    kind: str = "png"

    def __post_init__(self) -> None:
        if self.columns not in (1, 2):
            raise ValueError(f"figures are one or two columns wide, got {self.columns}")

    @property
    def width(self) -> float:
        """Inches."""
        return ONE_COLUMN if self.columns == 1 else TWO_COLUMNS

    @property
    def line_height(self) -> float:
        """Inches of the height of a plot of curves."""
        return 1.7 if self.columns == 1 else 2.3

    @property
    def settings(self) -> Any:
        """Matplotlib's settings."""
        if self.columns == 2:
            return SETTINGS
        return {name: SMALLEST if "size" in name else value for name, value in SETTINGS.items()} | {
            "figure.dpi": 300
        }

    def panels(
        self, count: int, windows: Sequence[Array], unit: str, below: float = 0.0, beside: float = 0.0
    ) -> tuple[Figure, NDArray[Any]]:
        """A figure with ``count`` panels side by side for each window (2, 2), and its axes (windows, count).

        Axes are equal, and labelled with the unit of length. On one column flat bodies stand one below the
        other. ``below`` inches stay free under the panels and ``beside`` at their right.
        """
        shape = [float(np.ptp(window[1]) / np.ptp(window[0])) for window in windows]
        stacked = self.columns == 1 and count > 1 and max(shape) < FLAT
        across = 1 if stacked else count
        width = (self.width - LABELS - beside) / (1 if stacked else max(across, self.columns))
        heights = [width * min(ratio, TALLEST) for ratio in shape for _ in range(count if stacked else 1)]
        whole = self.width if across > 1 or self.columns == 1 else LABELS + beside + width
        figure = new_figure(whole, sum(heights) + ABOVE * len(heights) + below)
        axes: NDArray[Any] = figure.subplots(
            len(heights), across, squeeze=False, sharex="col", height_ratios=heights
        )
        axes = axes.reshape(len(windows), count)
        for axis, limits in zip(axes.ravel(), np.repeat(windows, count, axis=0), strict=True):
            axis.set(xlim=limits[0], ylim=limits[1], aspect="equal")
            axis.set(xlabel=f"$x_1${bracketed(unit)}", ylabel=f"$x_2${bracketed(unit)}")
            axis.spines[:].set_visible(False)
            for one in (axis.xaxis, axis.yaxis):
                one.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            axis.label_outer()
        return figure, axes


def new_figure(width: float, height: float) -> Figure:
    """An empty figure that no window system knows of."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_legend(figure: Figure, axes: Sequence[Axes], place: Any = "outside upper center") -> None:
    """One legend for all axes, each name once, not wider than the figure; none without names."""
    shown: dict[Any, Artist] = {}
    for axis in axes:
        handles, names = axis.get_legend_handles_labels()
        shown.update(zip(names, handles, strict=True))
    if shown:
        room = int(LETTERS * figure.get_figwidth())
        longest = min(max(map(len, shown)), room - KEY)
        columns = max(1, min(len(shown), room // (longest + KEY)))
        names = [fill(name, room - KEY) for name in shown]
        figure.legend(list(shown.values()), names, loc=place, ncols=columns)


def lay_out(figure: Figure) -> None:
    """Place everything for good: with a layout engine matplotlib draws a figure twice to save it once."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def save(figure: Figure, stem: Path, kind: str, settings: Any = SETTINGS) -> Path:
    """Write the figure in a format and return its path."""
    path = stem.with_name(f"{stem.name}.{kind}")
    # of PNG files of such drawings zlib's level 3 makes smaller ones than 6, in less time
    options: Any = {"pil_kwargs": {"compress_level": 3}} if kind == "png" else {}
    with rc_context(settings):
        lay_out(figure)
        write_whole(path, partial(figure.savefig, format=kind, **options))
    return path
