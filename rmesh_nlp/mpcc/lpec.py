"""The linearised MPCC at a point, and descent directions over all its branches.

A feasible point is B-stationary (in the linearised sense) if ``d = 0`` solves the linear program with
equilibrium constraints (LPEC)::

    minimise gradient^T d   subject to   the active rows and bounds, linearised,   |d_j| <= 1,
        d_G = 0 (d_H = 0) where only G (only H) is zero,
        0 <= d_G  _|_  d_H >= 0   on the biactive pairs.

Z.-Q. Luo, J.-S. Pang, D. Ralph, Mathematical Programs with Equilibrium Constraints, 1996; as a
certificate and as a descent step: C. Kirches, J. Larson, S. Leyffer, P. Manns, Sequential linearization
method for bound-constrained MPCCs, SIAM J. Optim. 32 (2022) 75-99; A. Nurkanovic and S. Leyffer's MPECopt.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.optimize import Bounds, LinearConstraint, milp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import BoolArray, IntArray, Lifted

_ENUMERATE = 3  # up to 2^3 small linear programs are cheaper than a MILP
_NODES, _LEAST_NODES, _WORK = 5_000, 50, 1_000_000  # branch and bound is given up after so many, by size


@dataclass(frozen=True, eq=False)
class Linearisation:
    """First-order data of the lifted problem at a point, with its active bounds of rows and unknowns.

    The zero bound of a member is left to its pair: ``G_zero`` and ``H_zero``. Biactive: both.
    """

    gradient: Array
    jacobian: sp.csr_matrix
    row_lower: BoolArray
    row_upper: BoolArray
    z_lower: BoolArray
    z_upper: BoolArray
    G_zero: BoolArray
    H_zero: BoolArray

    @property
    def biactive(self) -> IntArray:
        """Pairs with both members at zero."""
        return np.flatnonzero(self.G_zero & self.H_zero).astype(np.int64)

    @property
    def scale(self) -> float:
        """``max(1, |gradient|_inf)``: the unit of a stationarity residual."""
        return max(1.0, float(np.max(np.abs(self.gradient), initial=0.0)))


def linearise(lifted: Lifted, z: Array, p: Array, tolerance: float, corner: float) -> Linearisation:
    """Derivatives and active sets at ``z``.

    A row or bound is active within ``tolerance (1 + |bound|)``, a member is zero below ``corner``. A row is
    measured in units of its steepness: what counts is how far away in the unknowns its bound is.
    """
    _, gradient, rows, jacobian = lifted.linearise(z, p)
    steep, nlp = steepness(jacobian), lifted.nlp

    def active(value: Array, bound: Array) -> BoolArray:
        finite = np.where(np.isfinite(bound), bound, 0.0)
        return np.isfinite(bound) & (np.abs(value - finite) <= tolerance * (1 + np.abs(finite)))

    return Linearisation(
        gradient, jacobian, active(rows / steep, nlp.lbg / steep), active(rows / steep, nlp.ubg / steep),
        active(z, nlp.lbx) & ~(lifted.member & (nlp.lbx == 0)), active(z, nlp.ubx),
        np.abs(z[lifted.first]) <= corner, np.abs(z[lifted.second]) <= corner,
    )  # fmt: skip


def steepness(jacobian: sp.csr_matrix) -> Array:
    """Largest entry of each row, at least 1."""
    if jacobian.shape[1] == 0:
        return np.ones(jacobian.shape[0])
    return np.asarray(np.maximum(1.0, abs(jacobian).max(axis=1).toarray().ravel()))


@dataclass(frozen=True, eq=False)
class Direction:
    """Answer of an LPEC: the best decrease (0 or negative), whether it is proven best, and the step.

    ``G_fixed[i]``: pair i keeps ``G = 0`` (False: ``H = 0``) along the step.
    """

    decrease: float
    step: Array
    G_fixed: BoolArray
    proven: bool = True


def descent(lifted: Lifted, lin: Linearisation, seconds: float = np.inf) -> Direction | None:
    """Solve the LPEC at a feasible point; None if it could not be solved within its limits."""
    lower, upper = np.where(lin.z_lower, 0.0, -1.0), np.where(lin.z_upper, 0.0, 1.0)
    lower[np.append(lifted.first[lin.G_zero], lifted.second[lin.H_zero])] = 0.0
    upper[lifted.first[lin.G_zero & ~lin.H_zero]] = 0.0
    upper[lifted.second[lin.H_zero & ~lin.G_zero]] = 0.0
    active = np.flatnonzero(lin.row_lower | lin.row_upper)
    rows = LinearConstraint(
        lin.jacobian[active],
        np.where(lin.row_lower[active], 0.0, -np.inf),
        np.where(lin.row_upper[active], 0.0, np.inf),
    )
    pairs, members = lin.biactive, np.zeros(lifted.nlp.n_x)
    if pairs.size > _ENUMERATE:
        found = _milp(lin.gradient, rows, lower, upper, lifted, lin.G_zero, pairs, members, seconds)
        # that no descent was found is an answer only if all branches were searched
        return None if found is None or (not found.proven and found.decrease >= 0) else found
    best: Direction | None = None
    for sides in itertools.product((True, False), repeat=pairs.size):
        on_G, here = lin.G_zero.copy(), upper.copy()
        on_G[pairs] = sides
        here[np.append(lifted.first[pairs[on_G[pairs]]], lifted.second[pairs[~on_G[pairs]]])] = 0.0
        found = _milp(lin.gradient, rows, lower, here, lifted, on_G, pairs[:0], members, np.inf)
        if found is None or not found.proven:
            return None
        if best is None or found.decrease < best.decrease:
            best = found
    return best


def nearest_branch(
    lifted: Lifted, z: Array, p: Array, radius: float, seconds: float = np.inf
) -> tuple[Array, BoolArray] | None:
    """A branch that the linearisation at an inexact point can satisfy: ``(z + step, G_fixed)``.

    The rows are elastic: their violation is minimised first, then the objective, over complementary
    steps of at most ``radius`` (the feasibility phase of MPECopt).
    """
    _, gradient, values, jacobian = lifted.linearise(z, p)
    nlp, m = lifted.nlp, lifted.nlp.n_g
    members = np.maximum(z, 0.0) / radius
    lower = np.maximum(-1.0, (nlp.lbx - z) / radius)
    upper = np.clip((nlp.ubx - z) / radius, lower, 1.0)
    lower = np.minimum(lower, upper)
    G, H = lifted.members(members)
    is_open = np.maximum(G, H) <= 1.0
    fix_G = G <= H
    at = np.append(lifted.first[fix_G & ~is_open], lifted.second[~fix_G & ~is_open])
    lower[at] = upper[at] = np.maximum(-members[at], -1.0)
    eye = sp.identity(m, format="csr")
    rows = LinearConstraint(
        sp.hstack([jacobian, eye, -eye], format="csr"),
        (nlp.lbg - values) / radius,
        (nlp.ubg - values) / radius,
    )
    weight = 1e3 * max(1.0, float(np.max(np.abs(gradient), initial=0.0)))
    elastic, pairs = np.zeros(2 * m), np.flatnonzero(is_open).astype(np.int64)
    found = _milp(
        np.append(gradient, elastic + weight), rows, np.append(lower, elastic),
        np.append(upper, elastic + np.inf), lifted, fix_G, pairs, members, seconds,
    )  # fmt: skip
    return None if found is None else (z + radius * found.step, found.G_fixed)


def _milp(
    cost: Array,
    rows: LinearConstraint,
    lower: Array,
    upper: Array,
    lifted: Lifted,
    sides: BoolArray,
    pairs: IntArray,
    members: Array,
    seconds: float,
) -> Direction | None:
    """One binary y per pair: ``m_G + d_G <= (m_G + 1) y`` and ``m_H + d_H <= (m_H + 1) (1 - y)``.

    ``members`` are the values m of the unknowns; ``d <= 1`` makes ``m + 1`` a valid big M. ``cost`` may be
    longer than the unknowns (elastic columns after them). ``sides`` are those of the other pairs.
    """
    n, k = cost.size, pairs.size
    first, second = lifted.first[pairs], lifted.second[pairs]
    constraints = []
    if k:
        pick = sp.identity(n, format="csr")
        top_G, top_H = members[first] + 1.0, members[second] + 1.0
        constraints += [
            LinearConstraint(sp.hstack([pick[first], -sp.diags(top_G)]), -np.inf, -members[first]),
            LinearConstraint(sp.hstack([pick[second], sp.diags(top_H)]), -np.inf, top_H - members[second]),
        ]
    if rows.A.shape[0]:
        wide = sp.hstack([rows.A, sp.csr_matrix((rows.A.shape[0], k))], format="csr")
        constraints.append(LinearConstraint(wide, rows.lb, rows.ub))
    options: dict[str, float] = {"node_limit": int(np.clip(_WORK / (n + k + 1), _LEAST_NODES, _NODES))}
    if np.isfinite(seconds):
        options["time_limit"] = seconds
    answer = milp(
        np.append(cost, np.zeros(k)),
        integrality=np.append(np.zeros(n), np.ones(k)),
        bounds=Bounds(np.append(lower, np.zeros(k)), np.append(upper, np.ones(k))),
        constraints=constraints,
        options=options,
    )
    if answer.x is None:
        return None
    G_fixed = sides.copy()
    G_fixed[pairs] = answer.x[n:] < 0.5
    return Direction(float(answer.fun), answer.x[: lifted.nlp.n_x], G_fixed, answer.status == 0)
