"""Results: the records of a folder, and several solutions side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from rmesh_nlp.errors import BadInputError, expect, expect_list
from rmesh_nlp.io.records import Record, objective_of
from rmesh_nlp.io.results import read_results
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.report.blocks import in_common_units
from rmesh_nlp.report.tables import frame, markdown
from rmesh_nlp.solving.formulation import Asked, Chooser, Formulation, Wrapper, check_taken, taken
from rmesh_nlp.solving.parts import DESIGN
from rmesh_nlp.solving.plan import compared
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.study.engine import ended
from rmesh_nlp.study.plan import planned

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
        One panel each.
    what : "mesh", "displacement", "stress" or "pressure"
        What is drawn of each.
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


# what is shown first; the whole records are beside them
ENERGIES = ("energy_initial_audited", "energy_audited", "gain_audited")
OBJECTIVE = ("objective_initial", "objective_value", "gain_surviving")  # of another than the energy
COLUMNS = ("iterations", "contact_solves", "wall_time_s", "status", "success")


@dataclass(frozen=True)
class Comparison:
    """What several formulations made of one problem.

    Attributes
    ----------
    solutions : mapping of str to Solution
        By formulation; one that raised has no solution, but a record with its message.
    records : tuple of dict
        One per formulation, as ``records.jsonl`` has them.
    names : tuple of str
        What they are called, in the same order.
    """

    solutions: Mapping[str, Solution]
    records: tuple[Record, ...]
    names: tuple[str, ...]

    def __getitem__(self, formulation: str) -> Solution:
        return self.solutions[formulation]

    @property
    def best(self) -> Solution:
        """The successful solution of least audited energy, or of the least value of another objective.

        Raises
        ------
        ValueError
            If no formulation succeeded.
        """
        good = [solution for solution in self.solutions.values() if solution.success]
        if not good:
            raise BadInputError("no formulation succeeded; see the messages of .records")
        return min(good, key=_last)

    def frame(self) -> pd.DataFrame:
        """Every scalar of the records, one row per formulation."""
        return frame(in_common_units(self.records)).set_axis(list(self.names))

    def markdown(self) -> str:
        """The tables of ``rmesh compare``."""
        return markdown(in_common_units(self.records))

    def summary(self) -> pd.DataFrame:
        """Audited energies, or another objective and the design, work and status; a row per formulation."""
        whole = self.frame()
        ends = ENERGIES if any(objective_of(record) == "energy" for record in self.records) else OBJECTIVE
        designs = (name for name in whole if name.startswith(DESIGN))
        return whole[[name for name in (*ends, *designs, *COLUMNS) if name in whole]]

    def __repr__(self) -> str:
        return self.summary().to_string(line_width=get_terminal_size().columns)

    def _repr_html_(self) -> str:
        return str(self.summary().to_html())


def _last(solution: Solution) -> float:
    """What was minimised, at the end."""
    if solution.objective.startswith("energy"):
        return solution.energy_audited
    return solution.final.objective


def compare(
    problem: ContactProblem,
    formulations: Sequence[Asked] = (),
    **options: Any,
) -> Comparison:
    """Solve a problem by several formulations.

    Parameters
    ----------
    problem : ContactProblem
        What all formulations solve.
    formulations : sequence of str or Formulation, optional
        Names of installed formulations, or objects such as ``Joint(first_barrier=1e-2)``; an object is
        called by its name and its settings that differ from the defaults, ``joint(first_barrier=0.01)``. By
        default those of "fixed", "nested", "joint" and "mpcc" that take the problem.
    options
        Those of :func:`rmesh_nlp.solve`, such as ``seed`` or ``limits``, for the formulations that take them.

    Raises
    ------
    ValueError
        If a formulation does not exist, or none takes an option.
    """
    expect("problem", problem, ContactProblem)
    expect_list("formulations", formulations, "names or formulations")
    formulations = formulations or compared(problem, options)
    check_taken(options, formulations)
    names = [one if isinstance(one, str) else described(one) for one in formulations]
    if len(set(names)) < len(names):
        raise BadInputError(f"a formulation is named twice in {names}")
    plan = [
        planned(problem, name, taken(one, options), made=None if isinstance(one, str) else one)
        for one, name in zip(formulations, names, strict=True)
    ]
    solutions, records = {}, []
    for solve, done in ended(plan):
        records.append(done.row if solve.made is None else {**done.row, "variant": solve.formulation})
        if done.solution is not None:
            solutions[solve.formulation] = done.solution
    return Comparison(solutions, tuple(records), tuple(names))


def described(formulation: Formulation | Chooser) -> str:
    """The name of a formulation with its settings that differ from the defaults."""
    settings = formulation.changed()
    parts = [f"{key}={value}" for key, value in settings.items() if key != "inner"]
    if isinstance(formulation, Wrapper):
        return f"{type(formulation).__name__.lower()}({', '.join([described(formulation.inner), *parts])})"
    return formulation.name + (f"({', '.join(parts)})" if parts else "")
