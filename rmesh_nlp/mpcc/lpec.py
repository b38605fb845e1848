"""Linear programs with equilibrium constraints: descent directions over all branches.

A feasible point is B-stationary (in the linearised sense) if ``d = 0`` solves::

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
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import IntArray, Lifted
from rmesh_nlp.mpcc.linearisation import Linearisation

_ENUMERATE = 3  # up to 2^3 small linear programs are cheaper than a MILP
_NODES, _LEAST_NODES, _WORK = 5_000, 50, 1_000_000  # branch and bound is given up after so many, by size


@dataclass(frozen=True, eq=False)
class Direction:
    """Answer of an LPEC: the best decrease (0 or negative), the step, and the side each pair takes.

    ``G_fixed[i]``: pair i keeps ``G = 0`` (False: ``H = 0``) along the step.
    """

    decrease: float
    step: Array
    G_fixed: NDArray[np.bool_]


def descent(lifted: Lifted, lin: Linearisation, seconds: float = np.inf) -> Direction | None:
    """Solve the LPEC at a feasible point; None if it could not be solved within its limit of nodes.

    ``seconds`` is what a user's time limit leaves.
    """
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
    return _mixed_integer(lifted, lin, lower, upper, rows, seconds)


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
    lifted: Lifted, lin: Linearisation, lower: Array, upper: Array, rows: LinearConstraint, seconds: float
) -> Direction | None:
    """The LPEC as a MILP over the biactive pairs, at the corner of the box."""
    found = _milp(lin.gradient, rows, lower, upper, lifted, lin.biactive, np.zeros(lifted.nlp.n_x), seconds)
    if found is None:
        return None
    step, on_G, decrease, proven = found
    if not proven and decrease >= 0:  # no descent found is only an answer if all was searched
        return None
    fix_G = lin.G_zero.copy()
    fix_G[lin.biactive] = on_G
    return Direction(decrease, step, fix_G)


def _milp(
    cost: Array,
    rows: LinearConstraint,
    lower: Array,
    upper: Array,
    lifted: Lifted,
    pairs: IntArray,
    members: Array,
    seconds: float,
) -> tuple[Array, NDArray[np.bool_], float, bool] | None:
    """One binary y per pair: ``m_G + d_G <= (m_G + 1) y`` and ``m_H + d_H <= (m_H + 1) (1 - y)``.

    ``members`` are the values m of the unknowns; the box ``d <= 1`` makes ``m + 1`` a valid big M.
    ``cost`` may be longer than the unknowns (elastic columns after them). Returns step, sides, value and
    whether the value is proven best.
    """
    n, k = cost.size, pairs.size
    first, second = lifted.first[pairs], lifted.second[pairs]
    pick = sp.identity(n, format="csr")
    top_G, top_H = members[first] + 1.0, members[second] + 1.0
    constraints = [
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
        np.concatenate([cost, np.zeros(k)]),
        integrality=np.concatenate([np.zeros(n), np.ones(k)]),
        bounds=Bounds(np.concatenate([lower, np.zeros(k)]), np.concatenate([upper, np.ones(k)])),
        constraints=constraints if k else constraints[2:],
        options=options,
    )
    if answer.x is None:
        return None
    return answer.x[: lifted.nlp.n_x], answer.x[n:] < 0.5, float(answer.fun), answer.status == 0


def nearest_branch(
    lifted: Lifted, z: Array, p: Array, radius: float, seconds: float = np.inf
) -> tuple[Array, NDArray[np.bool_]] | None:
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
    G, H = members[lifted.first], members[lifted.second]
    open_pairs = np.flatnonzero(np.maximum(G, H) <= 1.0).astype(np.int64)
    fix_G = G <= H
    closed = np.setdiff1d(np.arange(G.size), open_pairs)
    for places, fixed in ((lifted.first, fix_G), (lifted.second, ~fix_G)):
        at = places[closed[fixed[closed]]]
        lower[at] = upper[at] = np.maximum(-members[at], -1.0)
    eye = sp.identity(m, format="csr")
    rows = LinearConstraint(
        sp.hstack([jacobian, eye, -eye], format="csr"),
        (nlp.lbg - values) / radius,
        (nlp.ubg - values) / radius,
    )
    weight = 1e3 * max(1.0, float(np.max(np.abs(gradient), initial=0.0)))
    found = _milp(
        np.concatenate([gradient, np.full(2 * m, weight)]),
        rows,
        np.concatenate([lower, np.zeros(2 * m)]),
        np.concatenate([upper, np.full(2 * m, np.inf)]),
        lifted,
        open_pairs,
        members,
        seconds,
    )
    if found is None:
        return None
    step, on_G, _, _ = found
    fix_G[open_pairs] = on_G
    return z + radius * step, fix_G
