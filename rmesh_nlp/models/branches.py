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
:mod:`rmesh_nlp.mpcc.stationarity`. It costs one factorisation, and a back-substitution per biactive pair.

Its rates are in units of the first-order residual (:mod:`rmesh_nlp.models.residual`): the largest one on the
mesh as given is 1. Members of pairs are zero below ``ZERO`` in units of the largest displacement and of the
loads.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.models.kkt_model import Bilevel
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.mpcc import MPCC
from rmesh_nlp.mpcc.lifting import BoolArray, IntArray, lift
from rmesh_nlp.mpcc.lpec import linearise
from rmesh_nlp.mpcc.stationarity import stationarity
from rmesh_nlp.optimize.activity import ZERO

GIVEN = 1e-12
"""Largest change of a gap or of a slip by unit displacements that counts as none."""


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
    pairs: IntArray


class Branches:
    """Labels contact solutions of one outer problem; ``unit`` and ``tolerance`` are of its residual."""

    def __init__(self, program: Bilevel, unit: float, tolerance: float) -> None:
        self.program, self.tolerance, self._unit = program, tolerance, unit / program.value
        kept = program.mpcc.derivatives
        assert kept is not None
        self._gradient, self._rows = Evaluator(kept.grad_f), Evaluator(kept.jac_g)
        rows, columns = kept.jac_g.sparsity_out(1).get_triplet()
        self._at = np.asarray(rows), np.asarray(columns)

    def __call__(self, point: ReducedPoint) -> BranchLabel:
        """The label at a contact solution."""
        program, undecided = self.program, BranchLabel("", None, 0.0, np.zeros(point.q.size), _none())
        x = program.point(point.q, point.equilibrium, point.system)
        values, nonzeros = self._rows(x, [])
        _, slope = self._gradient(x, [])
        if not (np.all(np.isfinite(nonzeros)) and np.all(np.isfinite(slope))):
            return undecided
        jacobian = sp.csr_array((nonzeros, self._at), shape=(values.size, x.size))
        reduced = _reduced(program, x, values, jacobian, slope, self.tolerance)
        if reduced is None:
            return undecided
        lifted = lift(reduced.mpcc(self._unit))
        origin, weight = np.zeros(lifted.nlp.n_x), np.ones(1)
        lin = linearise(lifted, origin, weight, ZERO, ZERO)
        result = stationarity(lifted, lin, self.tolerance / lin.scale)
        if result.direction is None:
            return BranchLabel(result.label, result.b_stationary, 0.0, undecided.direction, reduced.pairs)
        step, decrease = result.direction.step[: point.q.size], result.direction.decrease
        size = float(np.max(np.abs(step), initial=0.0)) or 1.0
        return BranchLabel(result.label, result.b_stationary, decrease / size, step / size, reduced.pairs)


def _none() -> IntArray:
    return np.zeros(0, dtype=np.int64)


def held_members(
    program: Bilevel, jacobian: sp.csr_array, G: Array, H: Array, zero: float
) -> tuple[BoolArray, BoolArray]:
    """Which members of the pairs determine the contact solution, and which pairs are biactive.

    The first is True where G is held, else H is; with them the KKT conditions are a regular system. Of
    biactive pairs G is held: contact, and stick. Three kinds of pairs look biactive and are not, because
    their other member has no effect: where displacements are given in the direction of a gap or slip; at
    nodes that carry no friction at all, whose slip variable s is ``|u_t|`` by convention; and where friction
    sets in with the contact force at a node that slides, whose one condition of its own is the contact pair.
    """
    n_c, n_s, n_u = program.n_contact, program.friction_rows.size, program.n_u
    first = program.mpcc.n_g
    of_u = abs(jacobian[first : first + G.size, program.n_q : program.n_q + n_u])
    moves = (
        np.asarray(of_u.max(axis=1).todense()).ravel() > GIVEN if G.size and n_u else np.zeros(G.size, bool)
    )
    zero_G, zero_H = np.maximum(H, zero) >= G, zero >= H
    biactive = zero_G & zero_H & (zero >= G)
    held = zero_G.copy()
    gaps, minus, plus = slice(0, n_c), slice(n_c, n_c + n_s), slice(n_c + n_s, n_c + 2 * n_s)
    held[gaps] &= moves[gaps]
    biactive[gaps] &= moves[gaps]
    if n_s:
        is_open = ~held[gaps][program.friction_rows]
        slips = np.abs(G[plus] - G[minus]) > zero
        bare = H[minus] + H[plus] <= zero  # no friction
        one_sided = ~moves[minus] | (bare & (is_open | slips))
        forward = G[minus] <= G[plus]
        held[minus] = np.where(one_sided, forward, held[minus])
        held[plus] = np.where(one_sided, ~forward, held[plus])
        biactive[minus] &= ~one_sided
        biactive[plus] &= ~one_sided
    return held, biactive


@dataclass(frozen=True)
class _Reduced:
    """The small MPCC: rows of its parts in d and a, and the bounds that are active."""

    slope: Array  # (n + k,) of the objective
    second: Array  # (k, n + k): b
    rows: sp.csr_array  # (r, n + k): active constraints, >= 0, or = 0 where ``equal``
    equal: NDArray[np.bool_]
    lower: NDArray[np.bool_]  # (n,) outer variables at bounds
    upper: NDArray[np.bool_]
    pairs: IntArray

    def mpcc(self, unit: float) -> MPCC:
        """As an MPCC in d and in the members a and b, which are scaled to changes of d of one."""
        k, n = self.pairs.size, self.lower.size
        own = np.sum(np.abs(self.second[:, :n]), axis=1)
        first = np.where(own > 0, own, 1.0) / np.maximum(np.abs(np.diag(self.second[:, n:])), 1e-300)
        first = np.where(np.isfinite(first) & (first < 1e12), first, 1.0)
        second = own + np.abs(self.second[:, n:]) @ first
        second[second == 0] = 1.0
        scale = np.append(np.ones(n), first)
        rows = sp.csr_array(self.rows @ sp.diags_array(scale))
        largest = abs(rows).max(axis=1).toarray().ravel() if rows.nnz else np.ones(rows.shape[0])
        rows = sp.diags_array(1 / np.where(largest > 0, largest, 1.0)) @ rows
        of_b = sp.eye_array(k, k)
        equations = sp.hstack([sp.csr_array(self.second * scale / second[:, None]), -of_b])
        every = sp.vstack([equations, sp.hstack([rows, sp.csr_array((rows.shape[0], k))])])
        x, free = ca.MX.sym("x", n + 2 * k), np.full(2 * k, np.inf)
        _, a, b = ca.vertsplit(x, [0, n, n + k, n + 2 * k])
        return MPCC(
            x=x,
            f=ca.dot(ca.DM(np.append(self.slope * scale / unit, np.zeros(k))), x),
            g=_casadi(sp.csc_array(every)) @ x,
            G=a,
            H=b,
            lbx=np.append(np.where(self.lower, 0.0, -np.inf), -free),
            ubx=np.append(np.where(self.upper, 0.0, np.inf), free),
            lbg=np.zeros(k + self.equal.size),
            ubg=np.append(np.zeros(k), np.where(self.equal, 0.0, np.inf)),
        )


def _reduced(
    program: Bilevel, x: Array, values: Array, jacobian: sp.csr_array, slope: Array, tolerance: float
) -> _Reduced | None:
    """Eliminate the contact problem; None if its KKT conditions are singular or constraints violated."""
    mpcc, n = program.mpcc, program.n_q
    n_g, n_pairs = mpcc.n_g, mpcc.n_pairs
    inner = program.n_equations
    G, H = np.split(values[n_g:], 2)
    held, biactive = held_members(program, jacobian, G, H, ZERO)
    pairs = np.flatnonzero(biactive).astype(np.int64)
    numbers = n_g + np.arange(n_pairs)
    equations = np.concatenate([np.arange(inner), np.where(held, numbers, numbers + n_pairs)])
    of_q, of_y = jacobian[equations][:, :n], sp.csc_matrix(jacobian[equations][:, n:])
    lbg, ubg = np.asarray(mpcc.lbg)[inner:], np.asarray(mpcc.ubg)[inner:]
    g = values[inner:n_g]
    if np.max(np.maximum(lbg - g, g - ubg), initial=0.0) > tolerance:
        return None
    low, high = g - lbg <= tolerance, ubg - g <= tolerance
    rows = np.flatnonzero(low | high)
    try:
        factors = splu(of_y)
    except RuntimeError:  # exactly singular
        return None

    def total(of: Array) -> Array:
        """Derivative in d and a of a row (x.size,): with ``C_y y' + C_q d = a`` in the biactive rows."""
        w = factors.solve(of[n:], "T")
        return np.concatenate([of[:n] - of_q.T @ w, w[inner + pairs]])

    def whole(numbers: IntArray) -> Array:
        totals = [total(jacobian[[number]].toarray().ravel()) for number in numbers]
        return np.array(totals).reshape(-1, n + pairs.size)

    # those of elements are functions of the outer variables alone
    own = rows[rows < program.constraints.size]
    areas = jacobian[inner + rows[own.size :]][:, :n]
    areas = sp.hstack([areas, sp.csr_array((areas.shape[0], pairs.size))])
    constraints = sp.vstack([sp.csr_array(whole(inner + own)), areas])
    bounds = x[:n] - np.asarray(mpcc.lbx)[:n] <= tolerance, np.asarray(mpcc.ubx)[:n] - x[:n] <= tolerance
    derivatives = total(slope), whole(n_g + n_pairs + pairs)
    if not all(np.all(np.isfinite(part)) for part in (*derivatives, constraints.data)):
        return None
    signed = sp.csr_array(sp.diags_array(np.where(low[rows], 1.0, -1.0)) @ constraints)
    return _Reduced(*derivatives, signed, (low & high)[rows], *bounds, pairs)


def _casadi(matrix: sp.csc_array) -> ca.DM:
    pattern = ca.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())
    return ca.DM(pattern, matrix.data.tolist())
