"""An outer problem: everything that a formulation may use of it."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import Discretisation, discretise
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.constraints import is_constrained
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.mapping.validity import is_valid
from rmesh_nlp.models.branches import Branches
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.kkt_model import Bilevel, in_units_of
from rmesh_nlp.models.kkt_point import KKTConditions
from rmesh_nlp.models.reduced_constraints import ReducedConstraints
from rmesh_nlp.models.reduced_model import Reduced, ReducedEnergy, ReducedObjective, ReducedPoint
from rmesh_nlp.models.residual import OuterResidual
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.design import Level
from rmesh_nlp.solving.parts import Work

TOLERANCE = 1e-6
"""Default of ``tolerance``: the largest first-order residual of a point that is called stationary."""


@dataclass(frozen=True, eq=False)
class Outer:
    """``min F(X, u)`` over node positions X, where u solves the contact problem there.

    Models are built when they are first asked for.

    Attributes
    ----------
    contact : ContactSolver
        Contact solves by the problem's own rules, on its mesh.
    objective : Objective
        What is minimised.
    tolerance : float
        Largest first-order residual of a stationary point.
    is_near : bool
        Whether the start is likely to be close to a minimiser.
    gain : float or None
        Estimated error of the energy on the mesh as given, where it is known.
    """

    contact: ContactSolver
    objective: Objective
    tolerance: float = TOLERANCE
    is_near: bool = False
    gain: float | None = None

    @classmethod
    def of(
        cls, problem: ContactProblem, objective: str | Objective = "energy", tolerance: float = TOLERANCE
    ) -> Outer:
        """The outer problem on the mesh of a problem."""
        discretisation = discretise(problem)
        if discretisation.n_u == 0:  # such a problem may still be refined
            raise ProblemError("dirichlet", "every displacement is given: leave some node free")
        return cls(ContactSolver(discretisation), parse_objective(objective), tolerance)

    def minimising(self, objective: Objective, gain: float | None = None) -> Outer:
        """The same with another objective, and the estimated error of the energy if it is known."""
        return replace(self, objective=objective, gain=self.gain if gain is None else gain)

    def near(self) -> Outer:
        """The same from a start that is likely to be close to a minimiser, with the models built so far.

        The energy is one of them, which counts contact solves.
        """
        _ = self.energy
        near = copy(self)  # unlike `replace`, which makes one without models
        object.__setattr__(near, "is_near", True)
        return near

    @property
    def problem(self) -> ContactProblem:
        """On its mesh."""
        return self.contact.problem

    @property
    def discretisation(self) -> Discretisation:
        """Of the problem."""
        return self.contact.discretisation

    @cached_property
    def energy(self) -> ReducedEnergy:
        """The objective, or the energy where the levels do not collapse for it, as a function of q."""
        return ReducedEnergy(self.contact, self.objective if self.objective.collapses else ENERGY)

    @property
    def relocation(self) -> Relocation:
        """The NLP of ``energy``."""
        return self.energy.relocation

    @cached_property
    def function(self) -> Reduced:
        """The objective as a function of the outer variables, each value an exact contact solve."""
        return self.energy if self.objective.collapses else ReducedObjective(self.energy, self.objective)

    @cached_property
    def at_start(self) -> ReducedPoint:
        """The objective on the mesh as given; it counts as no contact solve of a formulation."""
        return self.function.of(self.energy.start)

    @cached_property
    def constraints(self) -> ReducedConstraints | None:
        """Those of the problem as functions of the outer variables; None without any."""
        if self.objective.collapses or not is_constrained(self.problem):
            return None
        return ReducedConstraints(self.conditions)

    @cached_property
    def residual(self) -> OuterResidual:
        """The first-order residual, relative to that on the mesh as given."""
        return OuterResidual(self.energy, self.at_start, self.constraints)

    @cached_property
    def conditions(self) -> KKTConditions:
        """The KKT conditions, in units of the contact solution and of the objective on the mesh as given."""
        if isinstance(self.function, ReducedObjective):
            return self.function.conditions
        return KKTConditions(in_units_of(self.discretisation, self.objective, self.energy.start))

    @property
    def kkt(self) -> Bilevel:
        """The KKT model of these conditions."""
        return self.conditions.program

    @cached_property
    def branches(self) -> Branches:
        """First-order conditions where contact is about to change, for objectives that have a KKT model."""
        return Branches(self.conditions, self.residual.unit, self.tolerance)

    @cached_property
    def initial(self) -> Admissible:
        """The displacement that is admissible for the continuous problem, on the mesh as given."""
        return admissible(self.discretisation, start=self.contact.given.active)

    def continuous(self, q: Array) -> Admissible:
        """The same at outer variables ``q``, without design variables; the last one is remembered."""
        if not np.any(q):
            return self.initial
        if q.tobytes() not in self._continuous:
            start = self.energy(q).equilibrium.active
            self._continuous.clear()
            self._continuous[q.tobytes()] = admissible(self.discretisation, self.nodes(q), start)
        return self._continuous[q.tobytes()]

    @cached_property
    def _continuous(self) -> dict[bytes, Admissible]:
        return {}

    @property
    def n(self) -> int:
        """Number of outer variables."""
        return self.discretisation.n_q

    def clipped(self, q: Array) -> Array:
        """The nearest outer variables within their limits."""
        return self.discretisation.mesh_map.clipped(q)

    def design(self, q: Array) -> dict[str, float]:
        """Design variables by their names at outer variables ``q``."""
        return dict(zip(self.problem.start, self.discretisation.mesh_map.design(q).tolist(), strict=True))

    @property
    def spent(self) -> Work:
        """Contact solves so far."""
        return Work(self.energy.contact_solves, self.energy.cold_solves, self.energy.factorisations)

    def figures(self, q: Array) -> dict[str, float]:
        """Those of the design variables that are of a design, and no levels of an epigraph."""
        own = {variable.name for variable in self.problem.design if not isinstance(variable, Level)}
        return {name: value for name, value in self.design(q).items() if name in own}

    def at_design(self, q: Array) -> tuple[Outer, Array]:
        """The outer problem with numbers in the place of design variables, and its outer variables.

        Nodes are where they are at ``q``; itself where there are no design variables.
        """
        if not self.problem.design:
            return self, q
        plain = Outer.of(self.problem.at_design(self.design(q)), self.objective, self.tolerance)
        if not np.any(q):  # where shapes begin
            return plain, np.zeros(plain.n)
        return plain, plain.discretisation.mesh_map.q_of(self.nodes(q))

    def nodes(self, q: Array) -> Array:
        """(2, nodes) positions at outer variables ``q``."""
        return self.discretisation.mesh_map.positions.values(q)

    @property
    def has_barrier(self) -> bool:
        """Whether the objective keeps elements valid by itself."""
        return self.objective.collapses and self.objective.has_barrier

    def is_valid(self, q: Array) -> bool:
        """Whether all elements are valid at outer variables ``q``, see :mod:`rmesh_nlp.mapping.validity`."""
        return is_valid(self.problem, self.nodes(q), by_barrier=self.has_barrier)

    def merit(self, point: ReducedPoint) -> tuple[float, float]:
        """By which points of the objective are compared: first the violation of constraints, then the value.

        A violation up to the tolerance counts as none.
        """
        violation = 0.0 if self.constraints is None else self.constraints.violation(point)
        return violation if violation > self.tolerance else 0.0, point.value

    def variables(
        self,
        positions: Array | None = None,
        seed: int | None = None,
        design: Mapping[str, float] | None = None,
    ) -> Array:
        """Where to start: zero, at ``positions`` (2, nodes), or drawn from the limits with a seed.

        Positions, and a ``design`` with them, are cut to the limits. Without move limits a draw moves nodes
        by up to their shortest edge. Outer variables that break element validity are halved until they do
        not.
        """
        free = self.discretisation.mesh_map
        if positions is not None:  # stay close to what was asked for; a draw may shrink faster
            at = np.array([{**self.problem.start, **(design or {})}[name] for name in self.problem.start])
            q, factor = free.clipped(free.q_of(positions, at)), 0.95
        elif seed is not None:
            low, high = np.maximum(free.lower, -1), np.minimum(free.upper, 1)
            low[free.n_positions :], high[free.n_positions :] = (
                limit[free.n_positions :] for limit in (free.lower, free.upper)
            )
            q, factor = np.random.default_rng(seed).uniform(low, high), 0.5
        else:
            return np.zeros(self.n)
        while not self.is_valid(q):
            q = factor * q
        return q
