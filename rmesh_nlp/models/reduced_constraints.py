"""Constraints of the outer problem as functions of the outer variables alone, each value a contact solve."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.constraints import boundary_of, unit_of
from rmesh_nlp.fem.contact_pressure import vertex_pressures
from rmesh_nlp.fem.pressure import contact_on
from rmesh_nlp.models.kkt_model import ContactPoint
from rmesh_nlp.models.kkt_point import KKTConditions
from rmesh_nlp.optimize.constraints import Linearised
from rmesh_nlp.problem.design import at_design


class ReducedConstraints:
    """The rows ``lower <= c(q) <= upper`` of a problem's constraints, in units of their bounds.

    Their derivatives are those along contact solutions with the active set held, as of the objective.
    """

    def __init__(self, conditions: KKTConditions) -> None:
        self._conditions, self.rows = conditions, conditions.program.constraints

    def at(self, point: ContactPoint) -> tuple[Array, Array]:
        """Values (rows,) and derivatives (rows, n_q) at a contact solution."""
        return self._conditions.at(point).constraints

    def values(self, point: ContactPoint) -> list[tuple[str, float, float, float]]:
        """Text, value, lower and upper bound of each constraint of the problem, in its own units."""
        parts, (reached, _) = self._conditions.program.parts, self.at(point)
        design = parts.mesh_map.design(point.q).tolist()
        named, values = dict(zip(parts.problem.start, design, strict=True)), []
        for constraint, rows in zip(parts.problem.constraints, self.rows.places, strict=True):
            lower, upper = constraint.bounds
            upper = at_design(upper, named)
            if (boundary := boundary_of(constraint)) is None:
                each = reached[rows] * unit_of(constraint)
            else:
                part, nodes = contact_on(parts.space, boundary), parts.mesh_map.positions.values(point.q)
                each = vertex_pressures(parts.space, nodes, part, point.equilibrium.normal_force)
            values.append((str(constraint.value), float(np.max(each)), lower, upper))
        return values

    def violation(self, point: ContactPoint) -> float:
        """Largest violation, in units of the bounds."""
        value, _ = self.at(point)
        return float(np.max(np.maximum(self.rows.lower - value, value - self.rows.upper), initial=0.0))

    def linearised(self, point: ContactPoint) -> Linearised:
        """All finite bounds as rows ``c >= 0``."""
        (value, jacobian), lower, upper = self.at(point), self.rows.lower, self.rows.upper
        low, high = np.isfinite(lower), np.isfinite(upper)
        slack = np.concatenate([(value - lower)[low], (upper - value)[high]])
        return Linearised(slack, sp.csr_array(np.vstack([jacobian[low], -jacobian[high]])))
