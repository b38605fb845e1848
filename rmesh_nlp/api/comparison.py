"""Several strategies on one problem, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from rmesh_nlp.campaign.cases import Case
from rmesh_nlp.campaign.run import solve
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.results import Record
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.report.tables import frame, markdown
from rmesh_nlp.solving.options import accepted
from rmesh_nlp.solving.solution import Solution

COLUMNS = (
    "energy_initial_audited",
    "energy_audited",
    "gain_audited",
    "iterations",
    "contact_solves",
    "wall_time_s",
    "status",
    "success",
)
"""What is shown first; the whole records are beside them."""


@dataclass(frozen=True)
class Comparison:
    """What several strategies made of one problem.

    Attributes
    ----------
    solutions : mapping of str to Solution
        By strategy; one that raised has no solution, but a record with its message.
    records : tuple of dict
        One per strategy, as ``records.jsonl`` has them.
    """

    solutions: Mapping[str, Solution]
    records: tuple[Record, ...]

    def __getitem__(self, strategy: str) -> Solution:
        return self.solutions[strategy]

    @property
    def best(self) -> Solution:
        """The successful solution of least audited energy.

        Raises
        ------
        ValueError
            If no strategy succeeded.
        """
        good = [solution for solution in self.solutions.values() if solution.success]
        if not good:
            raise ValueError("no strategy succeeded; see the messages of .records")
        return min(good, key=lambda solution: solution.audit.energy_audited)

    def frame(self) -> pd.DataFrame:
        """Every scalar of the records, one row per strategy."""
        return frame(self.records).set_index("formulation", drop=False)

    def markdown(self) -> str:
        """The tables of ``rmesh compare``."""
        return markdown(self.records)

    def summary(self) -> pd.DataFrame:
        """Audited energies, work and status, one row per strategy."""
        whole = self.frame()
        return whole[[name for name in COLUMNS if name in whole]]

    def __repr__(self) -> str:
        return self.summary().to_string()

    def _repr_html_(self) -> str:
        return str(self.summary().to_html())


def compare(
    problem: ContactProblem,
    formulations: Sequence[str] = ("fixed", "nested", "joint", "mpcc"),
    **options: Any,
) -> Comparison:
    """Solve a problem by several strategies.

    Parameters
    ----------
    problem : ContactProblem
    formulations : sequence of str
        Names of installed strategies.
    options
        Keywords for those strategies that take them, such as ``seed``.

    Raises
    ------
    ValueError
        If a strategy does not exist, or none takes an option.
    """
    if isinstance(formulations, str):
        raise BadInputError(f"formulations is a list of names, got the text {formulations!r}")
    if len(set(formulations)) < len(formulations):
        raise BadInputError(f"a strategy is named twice in {list(formulations)}")
    taken = {name: accepted(name, options) for name in formulations}
    for option in options:
        if not any(option in names for names in taken.values()):
            raise BadInputError(f"{option}: not an option of {', '.join(formulations)}")
    outcomes = {
        name: solve(Case(problem, name, {key: options[key] for key in options if key in names}))
        for name, names in taken.items()
    }
    return Comparison(
        {name: outcome.solution for name, outcome in outcomes.items() if outcome.solution is not None},
        tuple(outcome.record for outcome in outcomes.values()),
    )
