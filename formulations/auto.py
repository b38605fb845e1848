"""Which formulation suits a problem, and why.

A problem without move limits is solved over a cascade of coarser meshes (:mod:`formulations.cascade`), with
loads that are integrated exactly or by a rule of degree 8 at least. Where move limits, a least angle or
another objective are asked for, ``joint`` or ``nested`` is run, the latter where many nodes have move limits
that keep the elements valid. With constraints on a design ``mpcc`` is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from formulations.cascade import Cascade
from formulations.fixed import Fixed
from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from formulations.nested import Nested
from formulations.schedule import Schedule
from rmesh_nlp.fem.edge_gaps import conform, with_edge_gaps
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.mapping.validity import validity
from rmesh_nlp.meshes.mmg import is_available
from rmesh_nlp.models.regularisation import weights
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Open
from rmesh_nlp.solving.formulation import Choice, Chooser, Formulation
from rmesh_nlp.solving.plan import example_objective

MANY = 2000
"""Outer variables above which problems whose move limits keep the elements valid are solved by Newton-CG: the
time of ``joint`` grows like the square of the number of nodes. On plates with two holes of 517 and 1,381
nodes both gain the same in the same time. Where element areas are constraints Newton-CG stops at them, with
0.6 to 0.8 of the gain of ``joint`` on three problems of 2,558 to 3,838 outer variables."""

ENOUGH = 1e-3
"""Part of the gain so far below which a predicted step is not worth taking."""


DEGREE = 8
"""Least degree of the rule for loads where nodes move far: with 6 the gain is up to 9 % less, 14 takes up to
1.8 times as long. Where the assessment finds the rule exploited, the problem is solved again by degree 20."""


@dataclass(frozen=True)
class Auto(Chooser):
    """Chooses formulation, weights, meshes and quadrature.

    Attributes
    ----------
    cascade : Cascade
        Settings of the cascade, where it runs.
    regularisation : float, str or tuple of float, optional
        Final weight of the distortion in the place of that of the cascade, or a whole schedule.
    """

    cascade: Annotated[Cascade, Open(Cascade)] = field(default_factory=Cascade)
    regularisation: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.regularisation is not None:
            weights(self.regularisation)

    def choose(self, problem: ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        along = problem if problem.design else with_edge_gaps(problem)
        formulation, why = self._chosen(along, objective, is_started)
        is_free = along.motion.delta is None and isinstance(formulation, (Cascade, Schedule))
        if is_free or along.motion.min_angle > 0:
            degree = along.quadrature if isinstance(along.quadrature, int) else 0
            along = along.with_rule(along.exact_rule or max(degree, DEGREE))
        if along.obstacles != problem.obstacles:
            why += "; gaps along edges: a foundation is curved, or an interference varies"
        return Choice(formulation, along, why)

    def _chosen(
        self, problem: ContactProblem, objective: Objective, is_started: bool
    ) -> tuple[Formulation, str]:
        motion, free = problem.motion, MeshMap.of(problem)
        if problem.steps:
            return Fixed(), "fixed: load steps follow each other on one mesh"
        if problem.constraints:
            return AllAtOnce(), "mpcc: quantities of the contact are constrained"
        if not problem.has_energy and objective.is_energy:
            why = "fixed: with Coulomb friction no energy is minimised; an objective, such as "
            return Fixed(), f"{why}{example_objective(problem)!r}, would move nodes"
        if not objective.is_energy:
            return self._around(Nested()), "nested: the objective is not the energy"
        if motion.delta is not None:
            if free.n > MANY and self.regularisation is None and not validity(problem, free).size:
                why = f"nested, newton: nodes have move limits, and more than {MANY} outer variables are many"
                return Nested(enough=ENOUGH), why
            return self._around(Joint()), "joint: nodes have move limits"
        if motion.min_angle > 0:
            why = "joint, regularised: a least angle is asked for, which must hold as a constraint"
            return Schedule(Joint(), self.regularisation or Schedule.weights), why
        chosen = self._weighted()
        if is_started:
            why = "nested, newton: relocation from the start that was given"
            return Schedule(Nested(), chosen.regularisation, chosen.distortion), why
        if free.n == 0:
            return Nested(), "nested: no node can move"
        first = problem.at_design()
        along = [part for part in first.obstacles if first.order == 2 or part.other]
        if first.components == 2 and any(conform(first, part) for part in along):
            why = "fixed: nodes on arcs that fit what they touch gain by moving only where gaps do not hold "
            return Fixed(), f"{why}between nodes; with delta they are relocated"
        why = "cascade: relocation without move limits"
        if not is_available():
            why += "; with mmgpy installed --remesh begins on a mesh that suits the solution"
        return chosen, why

    def _around(self, formulation: Formulation) -> Formulation:
        return formulation if self.regularisation is None else Schedule(formulation, self.regularisation)

    def _weighted(self) -> Cascade:
        """The settings with another final weight, or with another schedule."""
        if self.regularisation is None:
            return self.cascade
        *before, last = weights(self.regularisation)
        return replace(self.cascade, regularisation=last, schedule=tuple(before) or self.cascade.schedule)
