"""The guaranteed bound of the error as an outer objective: upper less lower bound of the least energy.

The upper bound is the energy of the displacement by the rule of the audit, the lower one the dual energy of a
flux in equilibrium (:mod:`rmesh_nlp.certificate.lower_bound`). Half the square of the error in the energy
norm is at most their difference. Both are minima or maxima over the mesh, and both are differentiated with
what attains them held.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.certificate.lower_bound import LowerBound
from rmesh_nlp.certificate.shape_derivatives import DEGREE
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.energy_program import relocation
from rmesh_nlp.models.reduced import ReducedEnergy, ReducedObjective, ReducedPoint

NAME = "certificate"
"""Of the term in an objective."""


class ReducedCertificate:
    """An outer objective with the bound of the error among its terms, with its gradient.

    Attributes
    ----------
    energy : ReducedEnergy
        Of the problem with its own rule.
    objective : Objective
    upper : ReducedEnergy
        By the rule of the audit.
    weight : float
        Of the bound in the objective.

    Raises
    ------
    ValueError
        If the problem is not scalar, or is of a kind for which no certificate is known.
    """

    def __init__(self, energy: ReducedEnergy, objective: Objective) -> None:
        self.energy, self.objective = energy, objective
        problem = energy.relocation.problem
        self._lower = LowerBound(problem)
        self.upper = ReducedEnergy(relocation(replace(problem, quadrature=DEGREE)))
        self.weight = sum(weight for weight, term in objective.terms if term.name == NAME)
        others = tuple((weight, term) for weight, term in objective.terms if term.name != NAME)
        self._others = ReducedObjective(energy, Objective(others)) if others else None

    @property
    def contact_solves(self) -> int:
        """Number of contact solves so far, equilibrations included."""
        return self.energy.contact_solves + self.upper.contact_solves + self._lower.solves

    def is_defined(self, q: Array) -> bool:
        """Whether a distortion in the objective is defined: no element is inverted."""
        return self._others is None or self._others.is_defined(q)

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at moves ``q``."""
        return self.of(self.energy(q))

    def of(self, inner: ReducedPoint) -> ReducedPoint:
        """The objective where the energy and its contact solution are known."""
        upper = self.upper(inner.q)
        rel = self.upper.relocation
        displacement = rel.displacement.values(self.upper.point(inner.q, upper.equilibrium))
        lower, slope = self._lower(rel.nodes(inner.q), displacement)
        positions = rel.mesh_map.positions
        moving = positions.index != CONSTANT
        of_lower = np.bincount(
            positions.index[moving], (slope * positions.scale)[moving], minlength=inner.q.size
        )
        value, gradient = self.weight * (upper.value - lower), self.weight * (upper.gradient - of_lower)
        if self._others is not None:
            rest = self._others.of(inner)
            value, gradient = value + rest.value, gradient + rest.gradient
        return ReducedPoint(inner.q, value, gradient, inner.system, inner.equilibrium, False)
