"""What one solve runs: a formulation, chosen if that was asked for, and the problem as it takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.epigraph import with_levels
from rmesh_nlp.solving.formulation import Choice, Chooser, Formulation, Wrapper, name_of, wrappers
from rmesh_nlp.solving.start import Start


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
        formulation: Formulation | Chooser,
        objective: Objective,
        tolerance: float,
        start: Start,
        seed: int | None,
    ) -> Plan:
        """The plan of a solve; raises a BadInputError where the formulation does not take the problem."""
        problem = with_levels(problem, objective)
        asked = formulation
        _check_start(asked, {"start": start, "seed": seed})
        choice = _chosen(asked, problem, objective, start is not None or seed is not None)
        chosen = choice.formulation
        _check_energy(problem, objective, chosen)
        chosen.accepts(choice.problem, objective)
        if not chosen.relocates:
            start = seed = None
        return cls(chosen, choice.problem, objective, tolerance, start, seed, asked.name, choice.why)


def _check_start(asked: Formulation | Chooser, given: Mapping[str, Any]) -> None:
    """Raise a BadInputError where a start is given and a formulation makes its own."""
    if isinstance(asked, Wrapper):
        name = name_of(type(asked), wrappers)
        for option in asked.begins_by_itself:
            if given.get(option) is not None:
                raise BadInputError(f"{name} cannot be combined with {option}: it begins by itself")
        _check_start(asked.inner, {**given, name: True})


def _check_energy(problem: ContactProblem, objective: Objective, formulation: Formulation) -> None:
    """Raise a BadInputError where an energy is to be minimised that there is not."""
    energies = [term.name for _, term in objective.terms if term.name == "energy"]
    if not (energies and formulation.relocates):
        return
    example = f"which the objective {objective.text!r} would need: state another one, such as "
    example += f"{example_objective(problem)!r}, or solve on the mesh as given, by --formulation fixed"
    if problem.has_coulomb:
        raise BadInputError(f"with Coulomb friction no energy is minimised, {example}")
    if problem.design or problem.constraints:
        raise BadInputError(f"energies of different designs do not compare, {example}")


def example_objective(problem: ContactProblem) -> str:
    """An objective that suits a problem: the mean displacement of a boundary that is loaded, or may move."""
    loaded = [str(traction.boundary) for traction in problem.tractions]
    taken = {str(support.boundary) for support in problem.supports}
    taken |= {str(obstacle.boundary) for obstacle in problem.obstacles}
    free = [name for name in problem.mesh.boundaries or {} if name not in taken]
    where = next(iter((*loaded, *free)), None)
    displacement = "-u" if problem.components == 1 else "-uy"
    return f"body({displacement})" if where is None else f"mean({where}, {displacement})"


def _chosen(
    asked: Formulation | Chooser, problem: ContactProblem, objective: Objective, is_started: bool
) -> Choice:
    """A formulation, the problem as it is to be solved, and why; without a reason if it was asked for."""
    if isinstance(asked, Chooser):
        return asked.choose(problem, objective, is_started=is_started)
    if isinstance(asked, Wrapper):
        choice = _chosen(asked.inner, problem, objective, is_started)
        inner = choice.formulation
        wrapped = asked if inner is asked.inner else replace(asked, inner=inner)
        return Choice(wrapped, choice.problem, choice.why)
    return Choice(asked, problem, "")
