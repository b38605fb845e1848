"""What solves on refinements of both meshes say of a gain: of the error, of quantities, of the objective."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.contact_results import ContactResult, contact_results, worse
from rmesh_nlp.assessment.error_reduction import ErrorReduction, error_reduction
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import difference
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.recovery import interpolation_error, recovered
from rmesh_nlp.models.attainable import LeastErrors
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.state import objective_value

SURVIVES = 0.5
"""Least part of a gain by a formulation's own measure that must be left by an accurate one."""


@dataclass(frozen=True)
class Attained:
    """By how much the best mesh of as many triangles as the last one has would lower the error of the energy.

    ``share_of_attainable`` is its error over that of the last mesh: 1 if that is the best one.
    """

    attainable_factor: float
    share_of_attainable: float


def attained(
    gain: float, reduction: ErrorReduction, last: Admissible, finest: Admissible | None
) -> Attained | None:
    """Both from derivatives on the refined last mesh, on the last one itself where none was refined.

    ``gain`` is the decrease of the audited energy. The error of the last mesh is that of interpolation,
    within the bounds that are known.
    """
    fine = last if finest is None else finest
    triangles, refined = last.problem.mesh.nelements, fine.problem.triangles
    nodes = fine.body.nodes
    regions = recovered(fine.continuous.space, nodes, fine.displacement)
    times = (refined.shape[1] / triangles) ** last.problem.order  # how the error falls
    error = float(np.clip(times * interpolation_error(nodes, refined, regions), *reduction.error))
    least = min(LeastErrors.of(nodes, regions, triangles).any_mesh, error)
    return Attained((gain + error) / least, least / error) if least > 0 else None


@dataclass(frozen=True)
class ReducedError:
    """By how much the error fell.

    Attributes
    ----------
    reduction : ErrorReduction, optional
        Of the energy; None where nothing can be claimed.
    attained : Attained, optional
        How near the mesh comes to the best one of as many triangles.
    contact : mapping
        Results of the contact on the refined last mesh, where one was needed.
    warnings : tuple of str
    """

    reduction: ErrorReduction | None = None
    attained: Attained | None = None
    contact: Mapping[str, ContactResult] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def reduced_error(assessment: Assessment, contact_solves: int) -> ReducedError:
    """By how much the error of the energy fell; nothing for designs and with Coulomb friction."""
    given, final = assessment.given, assessment.final
    problem = final.problem
    has_energy = problem.has_energy and problem.origin is None and not final.design
    if given.continuous is None or final.continuous is None or not has_energy:
        return ReducedError()
    reduction, finest = error_reduction(given.continuous, final.continuous, contact_solves)
    best = None
    if reduction is not None:
        best = attained(assessment.gain_audited, reduction, final.continuous, finest)
    if finest is None:
        return ReducedError(reduction, best)
    # the admissible displacement is no equilibrium of forces at nodes
    solved = solve(finest.system, finest.state.active)
    fine = contact_results(finest.continuous.space, finest.body.nodes, finest.system, solved)
    return ReducedError(reduction, best, fine, tuple(worse(given.contact, final.contact, fine)))


@dataclass(frozen=True)
class SurvivingGain:
    """The part of the gain in an objective that is left on refined meshes, and a warning if it is small."""

    share: float
    objective: str

    @property
    def warnings(self) -> tuple[str, ...]:
        """One, if the share is small."""
        if self.share >= SURVIVES:
            return ()
        said = f"only {max(self.share, 0):.0%} of the gain in {self.objective} is left on refined meshes: "
        return (said + "the rest is an error of the discretisation",)


def surviving_gain(assessment: Assessment) -> SurvivingGain | None:
    """What is left on finer meshes of the gain in an objective other than the energy; None without one.

    No theorem says that a lower value is a truer one: a relocation may lower the mean deflection of a body by
    the error of the displacement alone, which is smaller on uniform refinements of the two meshes.
    """
    objective, point = _of_displacement(assessment.objective), assessment.final.point
    if not assessment.success or objective is None or point is None or not np.any(point.q):
        return None
    problems = [
        replace(state.problem, mesh=state.mesh, reference=None)
        for state in (assessment.given, assessment.final)
    ]
    fall, fall_refined = (
        difference(*(_value(problem, objective, refine) for problem in problems)) for refine in (False, True)
    )
    if not (fall > 0 and np.isfinite(fall_refined)):
        return None
    return SurvivingGain(fall_refined / fall, objective.text)


def _of_displacement(objective: Objective) -> Objective | None:
    """The terms that depend on the displacement; None where their gain needs no check."""
    if objective.collapses or objective.needs_exact:
        return None
    terms = tuple((weight, term) for weight, term in objective.terms if not term.of_positions)
    return Objective(terms) if terms else None


def _value(problem: ContactProblem, objective: Objective, refine: bool) -> float:
    """The objective on a mesh or its refinement; NaN where the contact problem has no solution there."""
    try:
        solver = ContactSolver(refined(problem) if refine else problem)
    except ProblemError:  # refined edges on a curve may fold a thin element
        return float("nan")
    if solver.given.status is not Status.CONVERGED:
        return float("nan")
    return objective_value(solver, objective, np.zeros(solver.discretisation.n_q), solver.given)
