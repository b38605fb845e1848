"""Constraints of the outer problem as functions of the outer variables alone, each value a contact solve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.constraints import boundary_of
from rmesh_nlp.fem.pressure import contact_on
from rmesh_nlp.models.kkt_model import ContactPoint
from rmesh_nlp.models.kkt_point import KKTConditions
from rmesh_nlp.optimize.constraints import Linearised
from rmesh_nlp.problem.coefficients import is_number
from rmesh_nlp.problem.design import at_design


@dataclass(frozen=True)
class ConstraintPoint:
    """Values (rows,) and derivatives (rows, n_q) of the constraints at a contact solution."""

    value: Array
    jacobian: Array


class ReducedConstraints:
    """The rows ``lower <= c(q) <= upper`` of a problem's constraints, in units of their bounds.

    Their derivatives are those along contact solutions with the active set held, as of the objective.
    """

    def __init__(self, conditions: KKTConditions) -> None:
        self._conditions, self.rows = conditions, conditions.program.constraints
        self._last: tuple[ContactPoint, ConstraintPoint] | None = None

    def at(self, point: ContactPoint) -> ConstraintPoint:
        """The rows at a contact solution."""
        if self._last is not None and self._last[0].equilibrium is point.equilibrium:
            return self._last[1]
        at, first = self._conditions.at(point), self._conditions.program.n_equations
        rows = slice(first, first + self.rows.size)
        jacobian, _ = at.totals(at.jacobian[rows].toarray())
        self._last = point, ConstraintPoint(at.rows[rows], jacobian)
        return self._last[1]

    def values(self, point: ContactPoint) -> list[tuple[str, float, float, float]]:
        """Text, value, lower and upper bound of each constraint of the problem, in its own units."""
        parts, names = self._conditions.program.parts, np.array(self.rows.names)
        reached = self.at(point).value
        design = parts.mesh_map.design(point.q).tolist()
        named = dict(zip(parts.problem.start, design, strict=True))
        values, used = [], dict.fromkeys(self.rows.names, 0)
        for constraint in parts.problem.constraints:
            text, lower, upper = str(constraint.value), constraint.bounds[0], constraint.bounds[1]
            upper = float(upper if is_number(upper) else at_design(upper, named))
            boundary, rows = boundary_of(constraint), np.flatnonzero(names == text)[used[text] :]
            if boundary is None:
                value = (reached * self.rows.unit)[rows[0]]
                used[text] += 1
            else:  # rows are forces less the level times the weights
                part, nodes = contact_on(parts.space, boundary), parts.mesh_map.positions.values(point.q)
                weights, rows = parts.space.weights(nodes)[part.rows], rows[: part.rows.size]
                value = upper + np.max((reached * self.rows.unit)[rows] / weights)
                used[text] += rows.size
            values.append((text, float(value), lower, upper))
        return values

    def violation(self, point: ContactPoint) -> float:
        """Largest violation, in units of the bounds."""
        value = self.at(point).value
        return float(np.max(np.maximum(self.rows.lower - value, value - self.rows.upper), initial=0.0))

    def linearised(self, point: ContactPoint) -> Linearised:
        """All finite bounds as rows ``c >= 0``."""
        evaluated, lower, upper = self.at(point), self.rows.lower, self.rows.upper
        low, high = np.isfinite(lower), np.isfinite(upper)
        slack = np.concatenate([(evaluated.value - lower)[low], (upper - evaluated.value)[high]])
        jacobian = np.vstack([evaluated.jacobian[low], -evaluated.jacobian[high]])
        return Linearised(slack, sp.csr_array(jacobian))
