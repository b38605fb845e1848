"""What one solve runs: a formulation, chosen if that was asked for, and the problem as it takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.epigraph import with_levels
from rmesh_nlp.solving.formulation import Chooser, Formulation, Keywords, check_start, composed, first
from rmesh_nlp.solving.outer import TOLERANCE, Outer
from rmesh_nlp.solving.start import Start

COMPARED = ("fixed", "nested", "joint", "mpcc")
"""Formulations of a comparison that names none."""


@dataclass(frozen=True)
class Plan:
    """A formulation, the problem, what is minimised, and from where.

    ``why`` is empty unless ``chooser`` chose the formulation.
    """

    formulation: Formulation
    problem: ContactProblem
    objective: Objective
    tolerance: float
    start: Start
    seed: int | None
    chooser: str
    why: str

    @classmethod
    def of(
        cls,
        problem: ContactProblem,
        formulation: str | Formulation | Chooser,
        *,
        objective: str | Objective = "energy",
        start: Start = None,
        seed: int | None = None,
        tolerance: float = TOLERANCE,
        **settings: Any,
    ) -> Plan:
        """The plan of a solve by the arguments of :func:`rmesh_nlp.solving.driver.solve`.

        Raises a BadInputError where the formulation does not take the problem or an option.
        """
        Keywords(tolerance, seed)
        asked, goal = composed(formulation, settings), parse_objective(objective)
        problem = with_levels(problem, goal)
        check_start(asked, {"start": start, "seed": seed})
        is_started = start is not None or seed is not None
        choice = asked.choose(problem, goal, is_started=is_started)
        chosen = choice.formulation
        _check_energy(problem, goal, chosen)
        chosen.accepts(choice.problem, goal)
        if not chosen.relocates:
            start = seed = None
        if (before := first(start)) is not None:
            before.accepts(choice.problem, goal)
        return cls(chosen, choice.problem, goal, tolerance, start, seed, asked.name, choice.why)

    def outer(self, problem: ContactProblem) -> Outer:
        """What is minimised, on the problem or on it by another rule."""
        return Outer.of(problem, self.objective, self.tolerance)


def compared(problem: ContactProblem, options: Mapping[str, Any]) -> Sequence[str]:
    """Those of ``COMPARED`` that take a problem with the objective of some options; all where none does."""
    objective, names = parse_objective(options.get("objective", "energy")), []
    for name in COMPARED:
        with suppress(BadInputError):
            Plan.of(problem, name, objective=objective)
            names.append(name)
    return names or COMPARED


def _check_energy(problem: ContactProblem, objective: Objective, formulation: Formulation) -> None:
    """Raise a BadInputError where an energy is to be minimised that there is not."""
    if not formulation.relocates or all(term.name != "energy" for _, term in objective.terms):
        return
    if problem.has_coulomb:
        why = "with Coulomb friction no energy is minimised"
    elif problem.design or problem.constraints:
        why = "energies of different designs do not compare"
    else:
        return
    raise BadInputError(
        f"{why}, which the objective {objective.text!r} would need: state another one, such as "
        f"{example_objective(problem)!r}, or solve on the mesh as given, by --formulation fixed"
    )


def example_objective(problem: ContactProblem) -> str:
    """An objective that suits a problem: the mean displacement of a boundary that is loaded, or may move."""
    loaded = [str(traction.boundary) for traction in problem.tractions]
    taken = {str(support.boundary) for support in problem.supports}
    taken |= {str(obstacle.boundary) for obstacle in problem.obstacles}
    free = [name for name in problem.mesh.boundaries or {} if name not in taken]
    where = next(iter((*loaded, *free)), None)
    displacement = "-u" if problem.components == 1 else "-uy"
    return f"body({displacement})" if where is None else f"mean({where}, {displacement})"
