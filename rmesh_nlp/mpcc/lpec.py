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

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.optimize import Bounds, LinearConstraint, milp

from rmesh_nlp.evaluation import Array, Index, Mask, magnitude
from rmesh_nlp.mpcc.lifting import Lifted, on_side
from rmesh_nlp.optimize.budget import LEAST_SECONDS, Budget

STDOUT = 1  # its file descriptor

_NODES, _LEAST_NODES, _WORK = 5_000, 50, 1_000_000  # branch and bound is given up after so many, by size


@dataclass(frozen=True, eq=False)
class Linearisation:
    """First-order data of the lifted problem at a point.

    ``lower`` and ``upper`` say which bounds are active, those of the rows, then those of the unknowns. The
    zero bound of a member is left to its pair: ``zero`` members are (2, n_pairs). Biactive: both.
    """

    gradient: Array
    jacobian: sp.csr_matrix
    lower: Mask
    upper: Mask
    zero: Mask

    @property
    def biactive(self) -> Index:
        """Pairs with both members at zero."""
        return np.flatnonzero(np.all(self.zero, axis=0))

    @property
    def scale(self) -> float:
        """``max(1, |gradient|_inf)``: the unit of a stationarity residual."""
        return max(1.0, magnitude(self.gradient))


def linearise(lifted: Lifted, z: Array, p: Array, tolerance: float, corner: float) -> Linearisation:
    """Derivatives and active sets at ``z``.

    A row or bound is active within ``tolerance (1 + |bound|)``, a member is zero below ``corner``. A row is
    measured in units of its steepness: what counts is how far away in the unknowns its bound is.
    """
    gradient, rows, jacobian = lifted.linearise(z, p)
    steep, nlp = steepness(jacobian), lifted.nlp
    values = np.append(rows / steep, z)

    def active(of_rows: Array, of_unknowns: Array) -> Mask:
        bound = np.append(of_rows / steep, of_unknowns)
        return np.isfinite(bound) & (np.abs(values - bound) <= tolerance * (1 + np.abs(bound)))

    own = np.where(lifted.member & (nlp.lbx == 0), -np.inf, nlp.lbx)
    zero = np.abs(z[lifted.pairs]) <= corner
    return Linearisation(gradient, jacobian, active(nlp.lbg, own), active(nlp.ubg, nlp.ubx), zero)


def steepness(jacobian: sp.csr_matrix) -> Array:
    """Largest entry of each row, at least 1."""
    if jacobian.shape[1] == 0:
        return np.ones(jacobian.shape[0])
    return np.maximum(1.0, abs(jacobian).max(axis=1).toarray().ravel())


@dataclass(frozen=True, eq=False)
class Direction:
    """Answer of an LPEC: the best decrease (0 or negative), whether it is proven best, and the step.

    Best among the branches that were searched.
    ``zero[0, i]``: pair i keeps ``G = 0`` along the step, ``zero[1, i]``: ``H = 0``.
    """

    decrease: float
    step: Array
    zero: Mask
    proven: bool = True


def descent(
    lifted: Lifted, lin: Linearisation, budget: Budget | None = None, signs: Array | None = None
) -> Direction | None:
    """Solve the LPEC at a feasible point; None if it could not be solved within its limits.

    ``signs``, multipliers of the members (2, n_pairs), name one branch, and its linear program is solved
    alone: of each biactive pair the member with the larger one is free.
    """
    (row_lower, z_lower), (row_upper, z_upper) = (
        np.split(active, [lifted.nlp.n_g]) for active in (lin.lower, lin.upper)
    )
    lower, upper = np.where(z_lower, 0.0, -1.0), np.where(z_upper, 0.0, 1.0)
    lower[lifted.pairs[lin.zero]] = 0.0
    corner = np.all(lin.zero, axis=0)
    kept = lin.zero & (~corner if signs is None else ~corner | on_side(signs[0] <= signs[1]))
    upper[lifted.pairs[kept]] = 0.0
    rows = LinearConstraint(lin.jacobian, np.where(row_lower, 0, -np.inf), np.where(row_upper, 0, np.inf))
    members = np.zeros(lifted.nlp.n_x)
    either = np.flatnonzero(corner & ~np.any(kept, axis=0))
    direction = _milp(lin.gradient, rows, lower, upper, lifted, kept[0], either, members, budget)
    # that no descent was found is an answer only if all branches were searched
    return None if direction is None or (not direction.proven and direction.decrease >= 0) else direction


def nearest_branch(
    lifted: Lifted,
    z: Array,
    values: Array,
    jacobian: sp.csr_matrix,
    radius: float,
    slope: Array | None,
    budget: Budget | None = None,
) -> tuple[Array, Mask] | None:
    """The branch that the linearised rows are nearest to: ``(z + step, zero members)``.

    The rows have ``values`` and a Jacobian at ``z``.

    Their violation is minimised first, then ``slope^T step``, over complementary steps of at most ``radius``
    (the feasibility phase of MPECopt); ``z`` is complementary and within its bounds. Without a slope steps
    need not be complementary: a linear program, whose least violation is at most that of all branches.
    """
    nlp, m, cost = lifted.nlp, lifted.nlp.n_g, 0.0 * z if slope is None else slope
    members = z / radius
    lower, upper = np.maximum(-1.0, (nlp.lbx - z) / radius), np.minimum(1.0, (nlp.ubx - z) / radius)
    zero, is_open = lifted.smaller(members), np.max(members[lifted.pairs], axis=0) <= 1.0
    at = lifted.pairs[zero & ~is_open]
    lower[at] = upper[at] = 0.0
    eye, elastic = sp.identity(m, format="csr"), np.zeros(2 * m)
    rows = LinearConstraint(
        sp.hstack([jacobian, eye, -eye], format="csr"),
        (nlp.lbg - values) / radius,
        (nlp.ubg - values) / radius,
    )
    direction = _milp(
        np.append(cost, elastic + 1e3 * max(1.0, magnitude(cost))), rows, np.append(lower, elastic),
        np.append(upper, elastic + np.inf), lifted, zero[0],
        np.flatnonzero(is_open), members, budget, slope is None,
    )  # fmt: skip
    if direction is None:
        return None
    trial = z + radius * direction.step
    return trial, lifted.smaller(trial) if slope is None else direction.zero


def limits(budget: Budget | None) -> dict[str, float]:
    """The options of HiGHS by which it stops in time."""
    return {} if budget is None else {"time_limit": max(budget.remaining, LEAST_SECONDS)}


@contextmanager
def _unprinted() -> Iterator[None]:
    """Without what HiGHS prints itself: a line for some solutions, which would stand among a user's JSON."""
    try:
        flush, kept = ctypes.CDLL(None).fflush, os.dup(STDOUT)
    except (OSError, TypeError):  # no standard output, or no C library by that name
        yield
        return
    flush(None)  # what waits in the buffer was printed by others
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), STDOUT)
        yield
    finally:
        flush(None)
        os.dup2(kept, STDOUT)
        os.close(kept)


def _milp(
    cost: Array,
    rows: LinearConstraint,
    lower: Array,
    upper: Array,
    lifted: Lifted,
    on_G: Mask,
    pairs: Index,
    members: Array,
    budget: Budget | None,
    relaxed: bool = False,
) -> Direction | None:
    """One binary y per pair: ``m_G + d_G <= (m_G + 1) y`` and ``m_H + d_H <= (m_H + 1) (1 - y)``.

    ``members`` are the values m of the unknowns; ``d <= 1`` makes ``m + 1`` a valid big M. ``cost`` may be
    longer than the unknowns (elastic columns after them). ``on_G`` are the sides of the other pairs.
    """
    n, k = cost.size, pairs.size
    first, second = lifted.pairs[:, pairs]
    constraints = []
    if k:
        pick = sp.identity(n, format="csr")
        top_G, top_H = members[first] + 1.0, members[second] + 1.0
        constraints += [
            LinearConstraint(sp.hstack([pick[first], -sp.diags(top_G)]), -np.inf, -members[first]),
            LinearConstraint(sp.hstack([pick[second], sp.diags(top_H)]), -np.inf, top_H - members[second]),
        ]
    if rows.A.shape[0]:
        steep = steepness(rows.A)  # HiGHS has one tolerance for all rows: entries of 1e9 exhaust it
        wide = sp.hstack([sp.diags(1 / steep) @ rows.A, sp.csr_matrix((steep.size, k))], format="csr")
        constraints.append(LinearConstraint(wide, rows.lb / steep, rows.ub / steep))
    nodes = int(np.clip(_WORK / (n + k + 1), _LEAST_NODES, _NODES))
    with _unprinted():
        answer = milp(
            np.append(cost, np.zeros(k)),
            integrality=np.append(np.zeros(n), np.full(k, not relaxed)),
            bounds=Bounds(np.append(lower, np.zeros(k)), np.append(upper, np.ones(k))),
            constraints=constraints,
            options={"node_limit": nodes, **limits(budget)},
        )
    if answer.x is None:
        return None
    on_G = on_G.copy()
    on_G[pairs] = answer.x[n:] < 0.5
    return Direction(float(answer.fun), answer.x[: lifted.nlp.n_x], on_side(on_G), answer.status == 0)
