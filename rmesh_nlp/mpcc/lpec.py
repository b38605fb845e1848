"""Linear programs with equilibrium constraints: is there a descent direction in some branch?

A feasible point is B-stationary (in the linearised sense) if ``d = 0`` solves::

    minimise gradient^T d   subject to   the active rows and bounds, linearised,   |d_j| <= 1,
        d_G = 0 (d_H = 0) where only G (only H) is zero,
        0 <= d_G  _|_  d_H >= 0   on the biactive pairs.

Z.-Q. Luo, J.-S. Pang, D. Ralph, Mathematical Programs with Equilibrium Constraints, 1996; as a certificate and
as a descent step: C. Kirches, J. Larson, S. Leyffer, P. Manns, Sequential linearization method for
bound-constrained MPCCs, SIAM J. Optim. 32 (2022) 75-99; A. Nurkanovic and S. Leyffer's MPECopt.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.stationarity import Linearisation

_ENUMERATE = 3  # up to 2^3 small linear programs are cheaper than a MILP
_TIME_LIMIT = 30.0


@dataclass(frozen=True, eq=False)
class Direction:
    """Answer of an LPEC: the best decrease (0 or negative), the step, and the side each pair takes.

    ``fix_G[i]``: pair i keeps ``G = 0`` (False: ``H = 0``) along the step.
    """

    decrease: float
    step: Array
    fix_G: NDArray[np.bool_]


def descent(lifted: Lifted, lin: Linearisation) -> Direction | None:
    """Solve the LPEC at a feasible point; None if it could not be solved within its limits."""
    lower, upper = np.full(lifted.nlp.n_x, -1.0), np.ones(lifted.nlp.n_x)
    lower[lin.z_lower] = 0.0
    upper[lin.z_upper] = 0.0
    lower[lifted.first[lin.G_zero]] = np.maximum(lower[lifted.first[lin.G_zero]], 0.0)
    lower[lifted.second[lin.H_zero]] = np.maximum(lower[lifted.second[lin.H_zero]], 0.0)
    only_G, only_H = lin.G_zero & ~lin.H_zero, lin.H_zero & ~lin.G_zero
    upper[lifted.first[only_G]] = 0.0
    upper[lifted.second[only_H]] = 0.0
    active = np.flatnonzero(lin.row_lower | lin.row_upper)
    rows = LinearConstraint(
        lin.jacobian[active],
        np.where(lin.row_lower[active], 0.0, -np.inf),
        np.where(lin.row_upper[active], 0.0, np.inf),
    )
    if lin.biactive.size <= _ENUMERATE:
        return _enumerate(lifted, lin, lower, upper, rows)
    return _mixed_integer(lifted, lin, lower, upper, rows)


def _enumerate(
    lifted: Lifted, lin: Linearisation, lower: Array, upper: Array, rows: LinearConstraint
) -> Direction | None:
    """One linear program per branch."""
    best: Direction | None = None
    for sides in itertools.product((True, False), repeat=lin.biactive.size):
        fix_G = lin.G_zero.copy()
        fix_G[lin.biactive] = sides
        here = upper.copy()
        chosen = np.array(sides, dtype=bool)
        here[lifted.first[lin.biactive[chosen]]] = 0.0
        here[lifted.second[lin.biactive[~chosen]]] = 0.0
        answer = linprog(lin.gradient, bounds=np.column_stack([lower, here]), method="highs", **_split(rows))
        if answer.status != 0:
            return None
        if best is None or answer.fun < best.decrease:
            best = Direction(float(answer.fun), answer.x, fix_G)
    return best


def _split(rows: LinearConstraint) -> dict[str, object]:
    """Two-sided rows as linprog takes them."""
    if rows.A.shape[0] == 0:
        return {}
    equal = (rows.lb == 0) & (rows.ub == 0)
    above, below = (rows.ub == 0) & ~equal, (rows.lb == 0) & ~equal
    A_ub = sp.vstack([rows.A[above], -rows.A[below]], format="csr")
    parts: dict[str, object] = {}
    if A_ub.shape[0]:
        parts.update(A_ub=A_ub, b_ub=np.zeros(A_ub.shape[0]))
    if np.any(equal):
        parts.update(A_eq=rows.A[equal], b_eq=np.zeros(int(equal.sum())))
    return parts


def _mixed_integer(
    lifted: Lifted, lin: Linearisation, lower: Array, upper: Array, rows: LinearConstraint
) -> Direction | None:
    """One binary y per biactive pair: ``d_G <= y``, ``d_H <= 1 - y``; the box makes 1 a valid big M."""
    n, k = lifted.nlp.n_x, lin.biactive.size
    one = sp.identity(k, format="csr")
    pick = sp.identity(n, format="csr")
    wide = LinearConstraint(
        sp.hstack([rows.A, sp.csr_matrix((rows.A.shape[0], k))], format="csr"), rows.lb, rows.ub
    )
    switch_G = LinearConstraint(sp.hstack([pick[lifted.first[lin.biactive]], -one]), -np.inf, 0.0)
    switch_H = LinearConstraint(sp.hstack([pick[lifted.second[lin.biactive]], one]), -np.inf, 1.0)
    answer = milp(
        np.concatenate([lin.gradient, np.zeros(k)]),
        integrality=np.concatenate([np.zeros(n), np.ones(k)]),
        bounds=Bounds(np.concatenate([lower, np.zeros(k)]), np.concatenate([upper, np.ones(k)])),
        constraints=[wide, switch_G, switch_H] if rows.A.shape[0] else [switch_G, switch_H],
        options={"time_limit": _TIME_LIMIT},
    )
    if answer.status != 0 or answer.x is None:
        return None
    fix_G = lin.G_zero.copy()
    fix_G[lin.biactive] = answer.x[n:] < 0.5
    return Direction(float(answer.fun), answer.x[:n], fix_G)
