"""What a user states: a frozen contact problem on a mesh whose nodes may move."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.display import html_table, plain_table, rich_table
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.problem.checks import check
from rmesh_nlp.problem.on_curves import onto_curves
from rmesh_nlp.problem.statement import Statement
from rmesh_nlp.problem.summary import summary_of_problem


@dataclass(frozen=True)
class ContactProblem(Statement):
    """A contact problem on a mesh with movable nodes, checked when it is stated.

    Fields are those of :class:`rmesh_nlp.problem.statement.Statement`.

    Raises
    ------
    ProblemError
        If a name is unknown, numbers of components disagree, held values contradict each
        other or are too few to hold the body, or a value is not finite.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self)
        try:
            object.__setattr__(self, "mesh", onto_curves(self.mesh, self.motion.curves))
        except ValueError as error:
            raise ProblemError("curves", str(error)) from error

    def with_rule(self, rule: str | int) -> ContactProblem:
        """The same with another quadrature rule; what was checked does not depend on it, and is not again."""
        other = copy(self)
        object.__setattr__(other, "quadrature", rule)
        vars(other).pop("rule", None)
        return other

    def summary(self) -> list[tuple[str, str]]:
        """What the problem says, as (label, value) rows for people."""
        return summary_of_problem(self)

    def __rich__(self) -> Any:
        return rich_table(f"Contact problem {self.name!r}", self.summary())

    def __repr__(self) -> str:
        return plain_table(f"Contact problem {self.name!r}", self.summary())

    def _repr_html_(self) -> str:
        return html_table(f"Contact problem {self.name!r}", self.summary())
