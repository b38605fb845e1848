"""What a figure is made for: one or two columns of a printed page, with letters of at least 7 points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.report.style import SETTINGS, TWO_COLUMNS, new_figure

ONE_COLUMN = 3.35
"""Width of one of two columns in inches."""

SMALLEST = 7.0
"""Points of the smallest letters."""

LABELS = 0.75
"""Inches of the width that the labels of a panel take."""

ABOVE = 0.62
"""Inches of the height that title and labels of a panel take."""

FLAT = 0.6
"""Height over width of a body below which two of them stand one below the other on one column."""

TALLEST = 2.0
"""Height of a panel over its width, at most."""


@dataclass(frozen=True)
class Page:
    """The width of a figure.

    Attributes
    ----------
    columns : int
        1 or 2.
    """

    columns: int = 2

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
            return dict(SETTINGS)
        small = ("font.size", "axes.titlesize", "axes.labelsize", "xtick.labelsize", "ytick.labelsize")
        return {**SETTINGS, **dict.fromkeys((*small, "legend.fontsize"), SMALLEST), "savefig.dpi": 300}

    def panels(self, count: int, windows: Sequence[Array], below: float = 0.0) -> tuple[Figure, NDArray[Any]]:
        """A figure with ``count`` panels side by side for each window (2, 2), and its axes (windows, count).

        On one column flat bodies stand one below the other. ``below`` inches stay free under them.
        """
        shape = [float(np.ptp(window[1]) / np.ptp(window[0])) for window in windows]
        stacked = self.columns == 1 and count > 1 and max(shape) < FLAT
        beside = 1 if stacked else count
        width = (self.width - LABELS) / (1 if stacked else max(beside, 2 if self.columns == 2 else 1))
        heights = [width * min(ratio, TALLEST) for ratio in shape]
        rows = [height for height in heights for _ in range(count if stacked else 1)]
        whole = self.width if beside > 1 or self.columns == 1 else LABELS + width
        figure = new_figure(whole, sum(rows) + ABOVE * len(rows) + below)
        axes: NDArray[Any] = figure.subplots(
            len(rows), beside, squeeze=False, sharex="col", sharey=False, height_ratios=rows
        )
        return figure, axes.reshape(len(windows), count)


def letters(figure: Figure) -> list[float]:
    """Sizes in points of all letters of a figure that are seen."""
    figure.draw_without_rendering()
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [float(text.get_fontsize()) for text in seen]
