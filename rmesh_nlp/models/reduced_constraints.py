"""Constraints of the outer problem as functions of the outer variables alone, each value a contact solve."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Block
from rmesh_nlp.fem.constraints import boundary_of, constraint_rows
from rmesh_nlp.fem.functional import Functional
from rmesh_nlp.fem.pressure import contact_on
from rmesh_nlp.models.kkt_model import kkt_unknowns
from rmesh_nlp.models.reduced_model import ReducedObjective, ReducedPoint
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

    With the active set held they have derivatives, by the adjoint of each row.
    """

    def __init__(self, function: ReducedObjective) -> None:
        self._function, rel = function, function.energy.relocation
        parts = rel.discretisation
        self.rows = rows = constraint_rows(parts.problem.constraints, parts.fields())
        self._n_sums = n = len(rows.sums)
        x = ca.MX.sym("x", function.n_x)
        groups = [*Functional([], rows.sums).rows, *(group.shifted(n) for group in rows.groups)]
        self._numeric = parts.assemble(groups, x, ca.MX(0, 1), n + rows.size).jacobian
        self._block = Block(self._numeric.pattern, slice(None), slice(None))
        self._last: tuple[ReducedPoint, ConstraintPoint] | None = None

    def at(self, point: ReducedPoint) -> ConstraintPoint:
        """The rows where the contact solution is known."""
        if self._last is not None and self._last[0].equilibrium is point.equilibrium:
            return self._last[1]
        rows = self._function.energy.relocation.friction_rows
        values, nonzeros = self._numeric(kkt_unknowns(point.q, point.equilibrium, point.system, rows), None)
        sums, value = np.split(values, [self._n_sums])
        slope = sp.csr_array(self._block(nonzeros))
        added, of_sums = self.rows.combined(sums)
        slopes = (slope[self._n_sums :] + sp.csr_array(of_sums) @ slope[: self._n_sums]).toarray()
        jacobian = np.array([self._function.total(point, row) for row in slopes])
        result = ConstraintPoint(value + added, jacobian.reshape(self.rows.size, point.q.size))
        self._last = point, result
        return result

    def values(self, point: ReducedPoint) -> list[tuple[str, float, float, float]]:
        """Text, value, lower and upper bound of each constraint of the problem, in its own units."""
        rel, names = self._function.energy.relocation, np.array(self.rows.names)
        reached = self.at(point).value
        design = rel.discretisation.mesh_map.design(point.q).tolist()
        named = dict(zip(rel.problem.start, design, strict=True))
        values, used = [], dict.fromkeys(self.rows.names, 0)
        for constraint in rel.problem.constraints:
            text, lower, upper = str(constraint.value), constraint.bounds[0], constraint.bounds[1]
            upper = float(upper if is_number(upper) else at_design(upper, named))
            boundary, rows = boundary_of(constraint), np.flatnonzero(names == text)[used[text] :]
            if boundary is None:
                value = (reached * self.rows.unit)[rows[0]]
                used[text] += 1
            else:  # rows are forces less the level times the weights
                space = rel.discretisation.space
                part = contact_on(space, boundary)
                weights, rows = space.weights(rel.nodes(point.q))[part.rows], rows[: part.rows.size]
                value = upper + np.max((reached * self.rows.unit)[rows] / weights)
                used[text] += rows.size
            values.append((text, float(value), lower, upper))
        return values

    def violation(self, point: ReducedPoint) -> float:
        """Largest violation, in units of the bounds."""
        value = self.at(point).value
        return float(np.max(np.maximum(self.rows.lower - value, value - self.rows.upper), initial=0.0))

    def linearised(self, point: ReducedPoint) -> Linearised:
        """All finite bounds as rows ``c >= 0``."""
        evaluated, lower, upper = self.at(point), self.rows.lower, self.rows.upper
        low, high = np.isfinite(lower), np.isfinite(upper)
        slack = np.concatenate([(evaluated.value - lower)[low], (upper - evaluated.value)[high]])
        jacobian = np.vstack([evaluated.jacobian[low], -evaluated.jacobian[high]])
        return Linearised(slack, slack, sp.csr_array(jacobian))
