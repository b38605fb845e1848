"""Results: the records of a folder, and several solutions side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rmesh_nlp.errors import BadInputError, expect
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import read_results
from rmesh_nlp.solving.solution import Solution

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 5.0  # inches of one panel; its height follows the body
BESIDE = 1.5  # inches that title, labels and colour bar take


def read_records(folder: str | Path) -> list[Record]:
    """The records of a folder that ``rmesh solve`` or ``rmesh compare`` wrote, oldest first.

    ``pandas.DataFrame(read_records(folder))`` makes a table of them.

    Raises
    ------
    ValueError
        If the folder holds none, or a line is not a record.
    """
    return [result.record for result in read_results(Path(folder))]


def plot(*solutions: Solution, what: str = "mesh", **style: Any) -> list[Axes]:
    """Draw the same field of one or several solutions, one panel each, on one scale.

    Parameters
    ----------
    solutions : Solution
    what : "mesh", "displacement", "stress" or "pressure"
    style
        Keywords of matplotlib's function that draws, such as ``cmap``, ``vmin``, ``vmax``.

    Returns
    -------
    list of matplotlib Axes
        In the order of the solutions; ``axes[0].figure`` is the figure.
    """
    from matplotlib import pyplot

    from rmesh_nlp.solving import plotting

    if not solutions:
        raise BadInputError("nothing to draw: give one or several solutions")
    for solution in solutions:
        expect("what is drawn", solution, Solution)
    n, extent = len(solutions), np.ptp(solutions[0].problem.mesh.p, axis=1)
    height = WIDTH * (0.6 if what == "pressure" else float(np.clip(extent[1] / extent[0], 0.1, 2.0)))
    _, (row,) = pyplot.subplots(
        1, n, figsize=(WIDTH * n, height + BESIDE), squeeze=False, sharey=True, layout="constrained"
    )
    for solution, axes in zip(solutions, row, strict=True):
        solution.plot(what, axes, **style)
        axes.set_title(f"{solution.formulation}: {axes.get_title()}")
    plotting.share_colours([one for axes in row for one in axes.collections if one.get_array() is not None])
    return list(row)
