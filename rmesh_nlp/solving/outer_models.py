"""The models of an outer objective on one mesh, each built when it is first asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.constraints import is_constrained
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.models.branches import Branches
from rmesh_nlp.models.kkt_model import Bilevel, bilevel, kkt_unknowns
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
    def energy_at_start(self) -> ReducedPoint:
        """The energy on the mesh as given; it counts as no contact solve of a formulation."""
        system = self.contact.system(self.contact.problem.mesh.p)
        zero = np.zeros(self.contact.discretisation.n_q)
        return self.energy.at(zero, system, self.contact.given)

    @cached_property
    def at_start(self) -> ReducedPoint:
        """The objective on the mesh as given; it counts as no contact solve either."""
        function = self.function
        if isinstance(function, ReducedEnergy):
            return self.energy_at_start
        return function.of(self.energy_at_start)

    @cached_property
    def constraints(self) -> ReducedConstraints | None:
        """Those of the problem as functions of the outer variables; None without any."""
        function = self.function
        if not (isinstance(function, ReducedObjective) and is_constrained(self.contact.problem)):
            return None
        return ReducedConstraints(function)

    @cached_property
    def residual(self) -> OuterResidual:
        """The first-order residual, relative to that on the mesh as given."""
        return OuterResidual(self.energy, self.at_start, self.constraints)

    @cached_property
    def kkt(self) -> Bilevel:
        """The KKT model in units of the contact solution and of the objective on the mesh as given."""
        parts, given = self.contact.discretisation, self.contact.given
        zero, system = np.zeros(parts.n_q), self.contact.system(parts.problem.mesh.p)
        return bilevel(
            parts,
            self.objective,
            length=float(np.max(np.abs(given.u), initial=0.0)) or 1.0,
            force=system.force_scale,
            value=abs(self.function(zero).value) or 1.0,
            start=kkt_unknowns(zero, given, system, parts.friction_rows),
        )

    @cached_property
    def branches(self) -> Branches:
        """First-order conditions where contact is about to change, for objectives that have a KKT model."""
        return Branches(self.kkt, self.residual.unit, self.tolerance)
