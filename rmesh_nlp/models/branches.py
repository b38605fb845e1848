"""First-order conditions of the outer problem at a contact solution, over all branches of its contact.

q -> F(X(q), u(q)) is smooth where every complementarity pair of the contact problem has one member that is
not zero, and piecewise smooth elsewhere: a pair that is biactive (gap and force both zero; no slip and
friction at its bound) may leave the corner either way. The KKT conditions of the contact problem, linearised
with the first members a of the biactive pairs as further unknowns, are a square system for all its unknowns;
so the change of the second members b, and of F, is a linear function of the change d of the outer variables
and of a. What is left of the outer problem is small,

    min  F_q . d + F_a . a     subject to    b = M d + N a,    0 <= a _|_ b >= 0,

with the active move limits, element areas and constraints linearised: an MPCC whose stationarity at zero is
that of the outer problem (the same multipliers, the other equations being regular). It is labelled by
:mod:`rmesh_nlp.mpcc.stationarity`. It costs a back-substitution per biactive
pair, and a factorisation where those are not all active.

Its rates are in units of the first-order residual (:mod:`rmesh_nlp.models.residual`): the largest one on the
mesh as given is 1. Members of pairs are zero below ``ZERO`` in units of the largest displacement and of the
loads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Index, constant_of, is_finite, magnitude
from rmesh_nlp.models.kkt_model import ContactPoint
from rmesh_nlp.models.kkt_point import KKTConditions, KKTPoint
from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.mpcc.lpec import descent, linearise
from rmesh_nlp.mpcc.stationarity import stationarity
from rmesh_nlp.optimize.activity import ZERO


@dataclass(frozen=True)
class BranchLabel:
    """Stationarity over the branches.

    Attributes
    ----------
    label : str
        The strongest of S, M, C, W for which multipliers exist; "none" if there are none at all, empty if
        nothing was decided.
    b_stationary : bool or None
        Whether no branch descends at more than the tolerance; None: not decided.
    rate : float
        The steepest descent that was found, at most 0: change of the objective per unit of the largest
        outer variable, where the steepest component of the gradient on the mesh as given has 1.
    direction : (n,) array
        Of the outer variables, along which that is the rate.
    pairs : int array
        The biactive pairs, by their numbers in the KKT model.
    """

    label: str
    b_stationary: bool | None
    rate: float
    direction: Array
    pairs: Index


class Branches:
    """Labels contact solutions of one outer problem; ``unit`` and ``tolerance`` are of its residual."""

    def __init__(self, conditions: KKTConditions, unit: float, tolerance: float) -> None:
        self._conditions, self._tolerance = conditions, tolerance
        self._unit = unit / conditions.program.value

    def __call__(self, point: ContactPoint) -> BranchLabel:
        """The label at a contact solution."""
        # pairs are biactive if both members are at most zero, whatever was active
        at, still = replace(self._conditions.at(point), held=None, zero=ZERO), np.zeros(point.q.size)
        reduced = _reduced(at, self._tolerance, self._unit)
        if reduced is None:
            return BranchLabel("", None, 0.0, still, np.zeros(0, dtype=np.int64))
        lifted = lift(reduced)
        origin, weight = np.zeros(lifted.nlp.n_x), np.ones(1)
        lin = linearise(lifted, origin, weight, ZERO, ZERO)
        result = stationarity(lifted, lin, self._tolerance / lin.scale)
        direction = None if result.direction is None else descent(lifted, lin)
        if direction is None:
            return BranchLabel(result.label, result.b_stationary, 0.0, still, at.pairs)
        step, decrease = direction.step[: point.q.size], direction.decrease
        size = magnitude(step) or 1.0
        return BranchLabel(result.label, result.b_stationary, decrease / size, step / size, at.pairs)


def _reduced(at: KKTPoint, tolerance: float, unit: float) -> MPCC | None:
    """The MPCC in d, a and b; None if the KKT conditions are singular or constraints violated."""
    program, n, first = at.program, at.program.parts.n_q, at.program.n_equations
    g = at.rows[first : program.rows["G"].start]
    lower, upper = program.lower[first:], program.upper[first:]
    violation = np.max(np.maximum(lower - g, g - upper), initial=0.0)
    if violation > tolerance or at.factors is None:
        return None
    low, high = g - lower <= tolerance, upper - g <= tolerance
    rows, k = np.flatnonzero(low | high), at.pairs.size

    def total(slopes: Array) -> Array:
        return np.concatenate(at.totals(slopes), axis=-1)

    # those of elements are functions of the outer variables alone
    own = rows[rows < program.constraints.size]
    areas = at.jacobian[first + rows[own.size :]][:, :n]
    areas = sp.hstack([areas, sp.csr_array((areas.shape[0], k))])
    constraints = sp.vstack([sp.csr_array(total(at.jacobian[first + own].toarray())), areas])
    slope = total(at.slope)
    second = total(at.jacobian[program.rows["H"].start + at.pairs].toarray())
    if not all(map(is_finite, (slope, second, constraints.data))):
        return None
    # the members a and b in units of their changes for changes of d of one
    by_q, by_a = np.sum(np.abs(second[:, :n]), axis=1), np.abs(second[:, n:])
    unit_a = np.where(by_q > 0, by_q, 1.0) / np.maximum(np.diag(by_a), 1e-300)
    unit_a = np.where(np.isfinite(unit_a) & (unit_a < 1e12), unit_a, 1.0)
    unit_b = by_q + by_a @ unit_a
    unit_b[unit_b == 0] = 1.0
    scale = np.append(np.ones(n), unit_a)
    active = sp.csr_array(constraints @ sp.diags_array(scale))
    largest = abs(active).max(axis=1).toarray().ravel() if active.nnz else np.ones(rows.size)
    signs = np.where(low[rows], 1.0, -1.0)
    active = sp.diags_array(signs / np.where(largest > 0, largest, 1.0)) @ active
    equations = sp.hstack([sp.csr_array(second * scale / unit_b[:, None]), -sp.eye_array(k, k)])
    every = sp.vstack([equations, sp.hstack([active, sp.csr_array((rows.size, k))])])
    x, unlimited, q = ca.MX.sym("x", n + 2 * k), np.full(2 * k, np.inf), at.x[:n]
    _, a, b = ca.vertsplit(x, [0, n, n + k, n + 2 * k])
    free = program.parts.mesh_map
    return MPCC(
        x=x,
        f=ca.dot(ca.DM(np.append(slope * scale / unit, np.zeros(k))), x),
        g=constant_of(every) @ x,
        G=a,
        H=b,
        lbx=np.append(np.where(q - free.lower <= tolerance, 0.0, -np.inf), -unlimited),
        ubx=np.append(np.where(free.upper - q <= tolerance, 0.0, np.inf), unlimited),
        lbg=np.zeros(k + rows.size),
        ubg=np.append(np.zeros(k), np.where((low & high)[rows], 0.0, np.inf)),
    )
