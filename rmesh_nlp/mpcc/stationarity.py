"""Stationarity of a feasible point of an MPCC from multipliers that are shown to exist.

At a point, with CasADi's signs and ``nu_G, nu_H`` the multipliers of a biactive pair (G = H = 0)::

    gradient f + sum lam_i gradient c_i + sum nu_G gradient G + sum nu_H gradient H = 0,

    W: nu_G, nu_H free          C: nu_G nu_H >= 0
    M: nu_G, nu_H <= 0, or one of them 0      S: nu_G, nu_H <= 0.

The multiplier of the zero member of a pair that is not biactive is free. H. Scheel and S. Scholtes,
Mathematical programs with complementarity constraints: stationarity, optimality, and sensitivity,
Math. Oper. Res. 25 (2000) 1-22; J. Outrata, Math. Oper. Res. 24 (1999) 627-644 for M.

Multipliers of degenerate problems are not unique, and those an interior-point method returns say
little. So the existence is asked of linear programs in the multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import linprog

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.linearisation import Linearisation, Multipliers, lagrangian_gradient

_NODES, _LEAST_NODES, _WORK = 500, 20, 200_000  # linear programs, of which large ones are dear
_OPTIMAL, _INFEASIBLE = 0, 2  # words of linprog


@dataclass(frozen=True, eq=False)
class Label:
    """The strongest of W, C, M, S for which multipliers exist, and those multipliers."""

    name: str
    multipliers: Multipliers | None


def witness(
    lifted: Lifted, lin: Linearisation, lam_rows: Array, lam_z: Array, tolerance: float
) -> Label | None:
    """Label S if the given NLP multipliers already prove it: no linear program is needed then."""
    residual = lin.gradient + lin.jacobian.T @ lam_rows + lam_z
    if np.max(np.abs(residual), initial=0.0) > tolerance * lin.scale:
        return None
    rows = _signed(lam_rows, lin.row_lower, lin.row_upper)
    nu, z = np.where(lifted.member & ~lin.z_lower, lam_z, 0.0), lam_z.copy()
    upper = lin.z_upper & (nu > 0)
    nu[upper] = 0.0
    z = _signed(np.where(lifted.member, lam_z - nu, lam_z), lin.z_lower, lin.z_upper)
    G, H = _share(lifted, lin, nu)
    bi = lin.biactive
    slack = tolerance * lin.scale
    multipliers = Multipliers(rows, z, G, H)
    wrong = max(np.max(G[bi], initial=0.0), np.max(H[bi], initial=0.0))
    error = lagrangian_gradient(lifted, lin, multipliers)
    if wrong > slack or np.max(np.abs(error), initial=0.0) > 2 * slack:
        return None
    return Label("S", multipliers)


def _signed(lam: Array, lower: NDArray[np.bool_], upper: NDArray[np.bool_]) -> Array:
    """Keep of each multiplier what the active bounds allow."""
    return np.where(lower, np.minimum(lam, 0.0), 0.0) + np.where(upper, np.maximum(lam, 0.0), 0.0)


def _share(lifted: Lifted, lin: Linearisation, nu: Array) -> tuple[Array, Array]:
    """Give the multiplier of each unknown to one pair it is in, preferably one where its sign is free."""
    G, H = np.zeros(lifted.first.size), np.zeros(lifted.second.size)
    left = nu.copy()
    both = lin.G_zero & lin.H_zero
    for pairs in (~both, both):
        for values, places, zero in ((G, lifted.first, lin.G_zero), (H, lifted.second, lin.H_zero)):
            use = np.flatnonzero(pairs & zero)
            _, once = np.unique(places[use], return_index=True)
            use = use[once]
            values[use] += left[places[use]]
            left[places[use]] = 0.0
    return G, H


class _MultiplierProgram:
    """Linear programs over the multipliers that make the Lagrangian stationary within ``tolerance``.

    Columns: active rows, active bounds, zero members of G, zero members of H, and for each biactive member
    a copy for the positive part, which costs 1: the minimum is 0 exactly if the point is S-stationary.
    """

    def __init__(self, lifted: Lifted, lin: Linearisation, tolerance: float, seconds: float) -> None:
        self.lifted, self.lin = lifted, lin
        self.decided = True
        self.limit = {"time_limit": seconds} if np.isfinite(seconds) else {}
        n = lifted.nlp.n_x
        eye = sp.identity(n, format="csc")
        self.rows = np.flatnonzero(lin.row_lower | lin.row_upper)
        self.bounds = np.flatnonzero(lin.z_lower | lin.z_upper)
        self.G, self.H = np.flatnonzero(lin.G_zero), np.flatnonzero(lin.H_zero)
        self.pairs = lin.biactive
        columns = [
            lin.jacobian.T.tocsc()[:, self.rows],
            eye[:, self.bounds],
            eye[:, lifted.first[self.G]],
            eye[:, lifted.second[self.H]],
            eye[:, lifted.first[self.pairs]],
            eye[:, lifted.second[self.pairs]],
        ]
        self.sizes = np.cumsum([0] + [part.shape[1] for part in columns])
        # Each coordinate of the Lagrangian gradient in units of its own terms would hide errors of badly
        # scaled problems; the unit is that of the whole objective gradient.
        matrix = sp.hstack(columns, format="csc")
        slack = tolerance * lin.scale
        self.matrix = sp.vstack([matrix, -matrix], format="csc")
        self.right = np.concatenate([slack - lin.gradient, slack + lin.gradient])
        self.lower, self.upper = self._free_bounds()
        self.cost = np.zeros(matrix.shape[1])
        self.cost[self.sizes[4] :] = 1.0

    def _free_bounds(self) -> tuple[Array, Array]:
        lin, n = self.lin, int(self.sizes[-1])
        lower, upper = np.zeros(n), np.zeros(n)
        lower[: self.sizes[1]] = np.where(lin.row_lower[self.rows], -np.inf, 0.0)
        upper[: self.sizes[1]] = np.where(lin.row_upper[self.rows], np.inf, 0.0)
        bounds = slice(self.sizes[1], self.sizes[2])
        lower[bounds] = np.where(lin.z_lower[self.bounds], -np.inf, 0.0)
        upper[bounds] = np.where(lin.z_upper[self.bounds], np.inf, 0.0)
        for k, zero in ((2, self.G), (3, self.H)):
            part = slice(self.sizes[k], self.sizes[k + 1])
            lower[part] = -np.inf
            upper[part] = np.where(np.isin(zero, self.pairs), 0.0, np.inf)
        upper[self.sizes[4] :] = np.inf
        return lower, upper

    def solve(self, pieces: dict[int, tuple[int, int]]) -> tuple[Multipliers, float] | None:
        """Multipliers whose signs on the biactive pairs follow ``pieces``, or None if there are none.

        ``pieces[k]`` restricts the k-th biactive pair: per member -1 (<= 0), 0 (= 0), 1 (>= 0), 2 (free).
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        for k, signs in pieces.items():
            for side, sign in enumerate(signs):
                zero = self.G if side == 0 else self.H
                minus = self.sizes[2 + side] + int(np.searchsorted(zero, self.pairs[k]))
                plus = self.sizes[4 + side] + k
                if sign in (0, 1):
                    lower[minus] = 0.0
                if sign in (-1, 0):
                    upper[plus] = 0.0
        if lower.size == 0:
            return (self._multipliers(np.zeros(0)), 0.0) if np.all(self.right >= 0) else None
        answer = linprog(
            self.cost,
            A_ub=self.matrix,
            b_ub=self.right,
            bounds=np.column_stack([lower, upper]),
            method="highs",
            options=self.limit,
        )
        self.decided &= answer.status in (_OPTIMAL, _INFEASIBLE)
        return (self._multipliers(answer.x), float(answer.fun)) if answer.status == _OPTIMAL else None

    def _multipliers(self, values: Array) -> Multipliers:
        s, lifted = self.sizes, self.lifted
        rows, z = np.zeros(lifted.nlp.n_g), np.zeros(lifted.nlp.n_x)
        G, H = np.zeros(lifted.first.size), np.zeros(lifted.second.size)
        if values.size:
            rows[self.rows] = values[: s[1]]
            z[self.bounds] = values[s[1] : s[2]]
            G[self.G] = values[s[2] : s[3]]
            H[self.H] = values[s[3] : s[4]]
            G[self.pairs] += values[s[4] : s[5]]
            H[self.pairs] += values[s[5] :]
        return Multipliers(rows, z, G, H)


_M_PIECES = ((-1, -1), (0, 2), (2, 0))
_C_PIECES = ((-1, -1), (1, 1))


def label(lifted: Lifted, lin: Linearisation, tolerance: float, seconds: float = np.inf) -> Label:
    """Return the strongest of S, M, C, W for which multipliers exist; ``"none"`` if there are none at all.

    A linear program that fails numerically decides nothing: the label is then weaker, or empty.

    ``tolerance`` is that of the Lagrangian gradient in units of ``max(1, |gradient f|)``.
    """
    program = _MultiplierProgram(lifted, lin, tolerance, seconds)
    weak = program.solve({})
    if weak is None:
        return Label("none" if program.decided else "", None)
    if weak[1] <= tolerance * lin.scale:
        return Label("S", weak[0])
    for name, pieces in (("M", _M_PIECES), ("C", _C_PIECES)):
        found = _search(program, pieces, tolerance * lin.scale)
        if found is not None:
            return Label(name, found)
    return Label("W", weak[0])


def _search(
    program: _MultiplierProgram, pieces: tuple[tuple[int, int], ...], zero: float
) -> Multipliers | None:
    """Depth-first search for multipliers that lie in one of ``pieces`` on every biactive pair."""
    stack: list[dict[int, tuple[int, int]]] = [{}]
    for _ in range(int(np.clip(_WORK / max(program.cost.size, 1), _LEAST_NODES, _NODES))):
        if not stack:
            return None
        node = stack.pop()
        found = program.solve(node)
        if found is None:
            continue
        G, H = found[0].G[program.pairs], found[0].H[program.pairs]
        outside = ~np.any([_inside(G, a, zero) & _inside(H, b, zero) for a, b in pieces], axis=0)
        if not np.any(outside):
            return found[0]
        k = int(np.argmax(np.where(outside, np.minimum(np.abs(G), np.abs(H)), -1.0)))
        stack.extend({**node, k: piece} for piece in reversed(pieces))
    return None


def _inside(value: Array, sign: int, zero: float) -> NDArray[np.bool_]:
    tests = {-1: value <= zero, 0: np.abs(value) <= zero, 1: value >= -zero, 2: np.ones(value.shape, bool)}
    return tests[sign]
