"""The models of an outer objective on one mesh, each built when it is first asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.constraints import is_constrained
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.models.branches import Branches
from rmesh_nlp.models.kkt_model import in_units_of
from rmesh_nlp.models.kkt_point import KKTConditions
from rmesh_nlp.models.reduced_constraints import ReducedConstraints
from rmesh_nlp.models.reduced_model import Reduced, ReducedEnergy, ReducedObjective, ReducedPoint
from rmesh_nlp.models.residual import OuterResidual


@dataclass(frozen=True, eq=False)
class OuterModels:
    """What can be evaluated of an objective.

    Attributes
    ----------
    contact : ContactSolver
        Contact solves by the problem's own rules.
    objective : Objective
    tolerance : float
        Largest first-order residual of a stationary point.
    built : ReducedEnergy, optional
        The ``energy``, where it is built already.
    """

    contact: ContactSolver
    objective: Objective
    tolerance: float
    built: ReducedEnergy | None = None

    @cached_property
    def energy(self) -> ReducedEnergy:
        """The objective, or the energy where the levels do not collapse for it, as a function of q."""
        if self.built is not None:
            return self.built
        return ReducedEnergy.of(self.contact, self.objective if self.objective.collapses else ENERGY)

    @cached_property
    def function(self) -> Reduced:
        """The objective as a function of the outer variables, each value an exact contact solve."""
        return self.energy if self.objective.collapses else ReducedObjective(self.energy, self.objective)

    @cached_property
    def at_start(self) -> ReducedPoint:
        """The objective on the mesh as given; it counts as no contact solve of a formulation."""
        start, function = self.energy.start, self.function
        if isinstance(function, ReducedEnergy):
            return function.at(start.q, start.system, start.equilibrium)
        return function.of(start)

    @cached_property
    def constraints(self) -> ReducedConstraints | None:
        """Those of the problem as functions of the outer variables; None without any."""
        if self.objective.collapses or not is_constrained(self.contact.problem):
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
        return KKTConditions(in_units_of(self.contact.discretisation, self.objective, self.energy.start))

    @cached_property
    def branches(self) -> Branches:
        """First-order conditions where contact is about to change, for objectives that have a KKT model."""
        return Branches(self.conditions, self.residual.unit, self.tolerance)
