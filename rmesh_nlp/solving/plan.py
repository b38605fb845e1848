"""What one solve runs: a formulation, chosen if that was asked for, and the problem as it takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.evaluation import Array, largest_side
from rmesh_nlp.fem.contact_pressure import vertex_pressures
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.pressure import LARGEST, contact_on, level_name
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS
from rmesh_nlp.problem import Constraint, ContactProblem
from rmesh_nlp.problem.design import Level
from rmesh_nlp.solving.formulation import (
    GIVEN,
    Asked,
    Formulation,
    Keywords,
    check_start,
    composed,
    first,
)
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import TOLERANCE, Outer
from rmesh_nlp.solving.relocated import Relocated

Start = str | Array | Relocated | None
"""Node positions (2, nodes), "given", the name of a formulation, a Solution; None for the usual start."""


def beginning(outer: Outer, start: Start, seed: int | None, monitor: Monitor) -> tuple[Outer, Array, str]:
    """The outer problem, told whether the start is near a minimiser, admissible outer variables, and a name.

    None is the mesh as given, or with a seed random outer variables. The name of a formulation runs it first,
    from where ``seed`` says; its time and contact solves count. The name for the record is "given", "random",
    "positions", that of a formulation, or "solution of" it.
    """
    if start is None and seed is not None:
        return outer, outer.variables(seed=seed), "random"
    if (before := first(start)) is not None:
        outcome = monitor.run(before, outer, outer.variables(seed=seed))
        return outer.near(), outcome.q, before.name
    if start is None or isinstance(start, str):
        return outer, outer.variables(), GIVEN
    if isinstance(start, Relocated):
        q = outer.variables(positions(outer, start.mesh.p), design=start.design)
        with monitor.budget.during("build"):
            return outer.near(), q, f"solution of {start.formulation}"
    nodes, free = positions(outer, start), outer.discretisation.mesh_map
    q = free.clipped(free.q_of(nodes, np.array([*outer.problem.start.values()])))
    far = np.max(np.abs(nodes - outer.nodes(q)), axis=0)
    if np.max(far) > SEVEN_DIGITS * largest_side(nodes):
        raise BadInputError(
            f"start: node {np.argmax(far)} is {np.max(far):.3g} away from where its move limits and "
            "the boundary that it is on let it be"
        )
    return outer, outer.variables(nodes), "positions"


def positions(outer: Outer, nodes: ArrayLike) -> Array:
    """Node positions as an array, checked to be those of the problem's mesh."""
    wanted = outer.problem.mesh.p.shape
    try:
        positions_of = np.asarray(nodes, dtype=float)
    except (TypeError, ValueError):
        said = f"got {one_line(repr(nodes))[:60]}"
        raise BadInputError(f"start must be a name, positions (2, nodes) or a Solution, {said}") from None
    if positions_of.ndim != 2 or positions_of.shape[0] != 2:
        raise BadInputError(
            f"start must hold positions (2, nodes), got an array of shape {positions_of.shape}"
        )
    if positions_of.shape != wanted:
        raise BadInputError(f"the start has {positions_of.shape[1]} nodes, the problem {wanted[1]}")
    if (lost := np.argwhere(~np.isfinite(positions_of))).size:
        raise BadInputError(f"start: node {int(lost[0][1])} has no finite position")
    return positions_of


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
        formulation: Asked,
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
        if problem.steps and not chosen.takes_steps:
            raise BadInputError("load steps are solved by fixed, with nothing around it")
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
    if not problem.has_energy:
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


HEADROOM = 10.0
"""Largest level, in units of the largest pressure at the start."""


def with_levels(problem: ContactProblem, objective: Objective) -> ContactProblem:
    """The problem with a level, and a constraint, for each largest pressure in an objective."""
    boundaries = [term.level_of for _, term in objective.terms if term.level_of is not None]
    if not boundaries:
        return problem
    solver = ContactSolver(problem.at_design())
    space, forces = solver.discretisation.space, solver.given.normal_force
    levels, constraints = [], []
    for boundary in dict.fromkeys(boundaries):
        part = contact_on(space, boundary)
        peak = float(np.max(vertex_pressures(space, solver.problem.mesh.p, part, forces)))
        if not peak > 0:
            said = f"nothing presses on {boundary!r} at the start: begin with a design that is in contact"
            raise BadInputError(f"{LARGEST}({boundary}): {said}")
        level = Level(level_name(boundary), peak, (0.0, HEADROOM * peak))
        levels.append(level)
        constraints.append(Constraint(f"{LARGEST}({boundary})", (-np.inf, level.symbol)))
    return replace(
        problem,
        design=(*problem.design, *levels),
        constraints=(*problem.constraints, *constraints),
    )
