"""How figures look: widths and letters of print, colours safe for the colour-blind; and their files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import rc_context, rc_params_from_file
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from rmesh_nlp.errors import unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.io.folder import Manifest, safe_name, write_whole
from rmesh_nlp.problem.units import NO_UNITS, Units
from rmesh_nlp.settings import Values

LABELS, ABOVE = 0.75, 0.62  # inches that labels take of a panel's width, title and labels of its height
TALLEST = 2.0  # height of a panel over its width, at most
LETTERS, KEY = 13.0, 8  # letters of a legend to the inch, and those that the line before a name takes
MARKERS = 15  # about as many markers on a curve
FORMATS = ("png", "pdf", "svg")
SETTINGS, COLUMN = (
    rc_params_from_file(Path(__file__).with_name(name), use_default_template=False)
    for name in ("figures.mplstyle", "column.mplstyle")
)

# Okabe and Ito's palette; markers differ in size, so that curves on top of each other show
PENS: Sequence[Values] = [
    {"color": color, "linestyle": linestyle, "marker": marker, "markersize": size}
    for color, linestyle, marker, size in (
        ("#000000", "--", "o", 4),
        ("#D55E00", "-", "s", 7),
        ("#0072B2", "-", "^", 5),
        ("#009E73", "-.", "D", 3.5),
        ("#CC79A7", ":", "v", 5),
        ("#E69F00", "--", "P", 5),
        ("#56B4E9", "-", "X", 5),
    )
]
CONTACT, IN_CONTACT, NEUTRAL, FOUNDATION = "#009E73", "#D55E00", "#56B4E9", "0.45"


def pen_of(position: int) -> Values:
    """What ``Axes.plot`` takes for the curve at a position in its figure."""
    return PENS[position % len(PENS)]


@dataclass(frozen=True)
class Page:
    """One or two columns of a printed page, with letters of at least 7 points; format and units."""

    columns: int = 2
    kind: str = "png"
    units: Units = NO_UNITS

    def __post_init__(self) -> None:
        if self.kind not in FORMATS:
            raise unknown("format", self.kind, FORMATS)

    @property
    def width(self) -> float:
        """Inches."""
        return float(self.settings["figure.figsize"][0])

    @property
    def narrow(self) -> float:
        """Inches of the width of a figure of one plot."""
        return self.width if self.columns == 1 else 0.6 * self.width

    @property
    def settings(self) -> Any:
        """Matplotlib's settings."""
        return SETTINGS if self.columns == 2 else {**SETTINGS, **COLUMN}

    def panels(self, count: int, windows: Sequence[Array], below: float = 0.0) -> tuple[Figure, NDArray]:
        """A figure with ``count`` panels side by side for each window (2, 2), and its axes (windows, count).

        Axes are equal, and labelled with the unit of length; of a body of revolution they are r and z, with
        its axis where that is in the window. On one column panels stand one below the other.
        ``below`` inches stay free under them.
        """
        across, stacked = (1, count) if self.columns == 1 else (count, 1)
        width = (self.width - LABELS) / max(across, self.columns)
        shapes = [float(np.ptp(window[1]) / np.ptp(window[0])) for window in windows]
        heights = [width * min(shape, TALLEST) for shape in shapes for _ in range(stacked)]
        figure = new_figure(LABELS + across * width, sum(heights) + ABOVE * len(heights) + below)
        axes: NDArray = figure.subplots(
            len(heights), across, squeeze=False, sharex="col", height_ratios=heights
        )
        axes = axes.reshape(len(windows), count)
        for axis, limits in zip(axes.ravel(), np.repeat(windows, count, axis=0), strict=True):
            axis.set(xlim=limits[0], ylim=limits[1], aspect="equal")
            axis.set(xlabel=self.units.axes[0], ylabel=self.units.axes[1])
            if self.units.per:
                axis.axvline(0.0, color="0.4", linewidth=0.8, linestyle="-.")
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


def write(drawn: Iterable[tuple[str, Figure]], manifest: Manifest, page: Page) -> list[Path]:
    """Write figures by name to the sub-folder ``figures``, each as it is made, and return the files.

    A name that an earlier figure has is numbered. They are noted in the manifest of the folder, and no file
    is replaced that is not; BadInputError if a file of the user's is in the way.
    """
    paths: list[Path] = []
    with rc_context(page.settings):
        for name, figure in drawn:
            stem, number = safe_name(name), 1
            while stem in {path.stem for path in paths}:
                number += 1
                stem = f"{safe_name(name)}-{number}"
            file = f"figures/{stem}.{page.kind}"
            manifest.claim(file)
            lay_out(figure)
            path = manifest.folder / file
            write_whole(path, partial(figure.savefig, format=page.kind))
            paths.append(path)
    return paths
