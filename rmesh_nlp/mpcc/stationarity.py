"""Stationarity of a feasible point of an MPCC from multipliers that are shown to exist.

At a point, with CasADi's signs and ``nu_G, nu_H`` the multipliers of a biactive pair (G = H = 0)::

    gradient f + sum lam_i gradient c_i + sum nu_G gradient G + sum nu_H gradient H = 0,

    W: nu_G, nu_H free          C: nu_G nu_H >= 0
    M: nu_G, nu_H <= 0, or one of them 0      S: nu_G, nu_H <= 0.

The multiplier of the zero member of a pair that is not biactive is free. H. Scheel and S. Scholtes,
Mathematical programs with complementarity constraints: stationarity, optimality, and sensitivity,
Math. Oper. Res. 25 (2000) 1-22; J. Outrata, Math. Oper. Res. 24 (1999) 627-644 for M.

Multipliers of degenerate problems are not unique. Those an interior-point method returns prove S where they
have its signs, and else say little: then the existence is asked of linear programs in the multipliers.
B: no branch descends to first order, asked of the linear program with equilibrium constraints (LPEC).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from rmesh_nlp.evaluation import Array, is_finite, magnitude
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.lpec import Direction, Linearisation, descent, limits
from rmesh_nlp.mpcc.result import beyond
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.status import Status

_NODES, _LEAST_NODES, _WORK = 500, 20, 200_000  # linear programs of a search, fewer of large ones
_SHARP = 1e-3  # part of the tolerance with which multipliers are asked for first, since they are used
_OPTIMAL, _INFEASIBLE = 0, 2  # words of linprog
AT_LEAST = "at least "
Range = tuple[float, float]
Piece = tuple[Range, Range]
"""Ranges of the two multipliers of a biactive pair."""

_LOW, _ZERO, _HIGH, _FREE = (-np.inf, 0.0), (0.0, 0.0), (0.0, np.inf), (-np.inf, np.inf)
_PIECES = {"M": ((_LOW, _LOW), (_ZERO, _FREE), (_FREE, _ZERO)), "C": ((_LOW, _LOW), (_HIGH, _HIGH))}


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the lifted problem: of rows, of bounds of z, of members (2, n_pairs)."""

    rows: Array
    z: Array
    pairs: Array


class Columns:
    """M in ``gradient + M lambda = 0``: gradients of rows, bounds of z and members of pairs at a point.

    Attributes
    ----------
    matrix : sparse (n_x, number of columns)
    corner : bool array
        Of each column whether it is a member of a biactive pair.
    low, high : arrays
        Bounds of the multipliers with the signs of S: that of an active lower bound, and of every zero
        member, may be negative; that of a member of the corner may not be positive.
    """

    def __init__(self, lifted: Lifted, lin: Linearisation) -> None:
        self._ends = lifted.nlp.n_g, lin.lower.size
        eye = sp.identity(lifted.nlp.n_x, format="csc")
        self.matrix = sp.hstack([lin.jacobian.T, eye, eye[:, lifted.pairs.ravel()]], format="csc")
        corner = lin.zero & lin.zero[::-1]
        self.corner = np.append(np.zeros_like(lin.lower), corner)
        self.low = np.where(np.append(lin.lower, lin.zero), -np.inf, 0.0)
        self.high = np.where(np.append(lin.upper, lin.zero & ~corner), np.inf, 0.0)

    def split(self, values: Array) -> Multipliers:
        """Multipliers of the columns by their kinds."""
        rows, z, pairs = np.split(values, self._ends)
        return Multipliers(rows, z, pairs.reshape(2, -1))


def proving(lifted: Lifted, lin: Linearisation, lam_rows: Array, tolerance: float) -> Multipliers | None:
    """Multipliers with the signs of S from those of the rows at the end of a solve; None if they have others.

    Those of bounds and members are what the Lagrangian leaves to them. It is stationary within ``tolerance``.
    """
    columns, n_rows, n_x = Columns(lifted, lin), lifted.nlp.n_g, lifted.nlp.n_x
    values = np.zeros(columns.corner.size)
    values[:n_rows] = lam_rows[:n_rows]
    values = np.clip(values, columns.low, columns.high)
    rest = -(lin.gradient + columns.matrix @ values)
    # an unknown may be a member of several pairs: the one with the freest sign takes all
    order = np.argsort(columns.corner, kind="stable")
    order = order[(columns.low < columns.high)[order] & (order >= n_rows)]
    unknowns, first = np.unique(np.append(np.arange(n_x), lifted.pairs)[order - n_rows], return_index=True)
    values[order[first]] = rest[unknowns]
    values = np.clip(values, columns.low, columns.high)
    residual = magnitude(lin.gradient + columns.matrix @ values)
    return columns.split(values) if residual <= tolerance * lin.scale else None


@dataclass(frozen=True, eq=False)
class Stationarity:
    """The label of a point, the multipliers that prove it, and a direction of descent where there is one.

    ``label`` is ``"none"`` if there are no multipliers at all and empty if nothing was decided; ``"at least
    C"`` if a search for M ran out of nodes;
    ``b_stationary`` is None if the LPEC could not be decided within its limits.
    """

    label: str
    multipliers: Multipliers | None = None
    b_stationary: bool | None = None
    direction: Direction | None = None

    @property
    def status(self) -> Status:
        """CONVERGED if B-stationary and labelled; ACCEPTABLE with a label but B undecided; else STALLED.

        Without a label (its linear programs failed) nothing is proven, so it is never a success.
        """
        if self.label and self.b_stationary:
            return Status.CONVERGED
        undecided = self.label and self.b_stationary is None and self.multipliers is not None
        return Status.ACCEPTABLE if undecided else Status.STALLED


UNLABELLED = Stationarity("")


def stationarity(
    lifted: Lifted,
    lin: Linearisation,
    tolerance: float,
    budget: Budget | None = None,
    lam_rows: Array | None = None,
    search: bool = True,
    is_last: bool = True,
) -> Stationarity:
    """Label a linearised point and look for descent over its branches.

    ``tolerance`` is that of the Lagrangian gradient and of descent, in units of ``max(1, |gradient f|)``.
    ``lam_rows``, multipliers of the rows at the end of a solve, decide if they prove S; else linear programs
    do, or nothing without ``search``. A point along which a branch descends is labelled only if it
    ``is_last``.
    """
    if not (is_finite(lin.gradient) and is_finite(lin.jacobian.data)):
        return UNLABELLED
    proof = None if lam_rows is None else proving(lifted, lin, lam_rows, tolerance)
    if proof is not None:
        return Stationarity("S", proof, True)
    if not search:
        return UNLABELLED
    programs, zero = _MultiplierLP(lifted, lin, tolerance, budget), tolerance * lin.scale
    weak = programs.solve({})
    least = weak if weak is None or weak[1] <= zero else programs.solve({}, (1.0,)) or weak
    if least is not None and least[1] <= zero:
        return Stationarity("S", least[0], True)  # S implies B
    direction, is_b = None, None
    # one linear program first: most of the branches along which f falls are named by the signs
    for signs in (None,) if weak is None else (weak[0].pairs, None):
        direction = descent(lifted, lin, budget, signs)
        is_b = None if direction is None else direction.decrease >= -zero
        if is_b is False:
            break
    own = None if weak is None else weak[0]
    label = "none" if programs.decided else ""
    if weak is not None and (is_last or is_b is not False):
        label, own = _weaker(programs, weak, zero)
    return Stationarity(label, own, is_b, None if is_b is not False else direction)


class _MultiplierLP:
    """Linear programs over the multipliers that make the Lagrangian stationary within ``tolerance``.

    After the ``Columns`` of the point stands for each biactive member a copy for the positive part of its
    multiplier, which costs 1: the minimum is 0 exactly if the point is S-stationary. The last columns are
    what is left of the Lagrangian's gradient.
    """

    def __init__(self, lifted: Lifted, lin: Linearisation, tolerance: float, budget: Budget | None) -> None:
        self.columns, self.pairs, self.decided = Columns(lifted, lin), lin.biactive, True
        self.budget = budget
        self.at_corner = np.flatnonzero(self.columns.corner)
        # Each coordinate of the Lagrangian gradient in units of its own terms would hide errors of badly
        # scaled problems; the unit is that of the whole objective gradient.
        own, eye = self.columns.matrix, sp.identity(lin.gradient.size, format="csc")
        self.matrix = sp.hstack([own, own[:, self.at_corner], eye], format="csc")
        self.right, self.slack = -lin.gradient, tolerance * lin.scale
        copies, rest = np.zeros(self.at_corner.size), np.zeros(lin.gradient.size)
        self.lower = np.concatenate([self.columns.low, copies, rest])
        self.upper = np.concatenate([self.columns.high, copies + np.inf, rest])
        self.cost = np.concatenate([0.0 * self.columns.corner, copies + 1.0, rest])

    def solve(
        self, pieces: dict[int, Piece], parts: tuple[float, ...] = (_SHARP, 1.0)
    ) -> tuple[Multipliers, float] | None:
        """Multipliers within ``pieces[k]`` on the k-th biactive pair, and their cost, if there are any.

        Those within the first of the ``parts`` of the tolerance for which there are some.
        """
        bounds = np.column_stack([self.lower, self.upper])
        n_columns, n_rest = self.columns.corner.size, self.right.size
        for k, piece in pieces.items():
            for copy, (low, high) in zip((k, k + self.pairs.size), piece, strict=True):
                bounds[self.at_corner[copy], 0], bounds[n_columns + copy, 1] = low, high
        # of small programs that are infeasible, interior points of old versions of HiGHS may say nothing
        for part, method in [*((part, "highs-ipm") for part in parts), (parts[-1], "highs-ds")]:
            bounds[-n_rest:] = part * self.slack * np.array([-1.0, 1.0])
            answer = linprog(
                self.cost, A_eq=self.matrix, b_eq=self.right, bounds=bounds, method=method,
                options=limits(self.budget),
            )  # fmt: skip
            if answer.status == _OPTIMAL or (answer.status, part) == (_INFEASIBLE, parts[-1]):
                break
        self.decided &= answer.status in (_OPTIMAL, _INFEASIBLE)
        if answer.status != _OPTIMAL:
            return None
        values, copies, _ = np.split(answer.x, [n_columns, bounds.shape[0] - n_rest])
        values[self.at_corner] += copies
        return self.columns.split(values), float(answer.fun)


def _weaker(programs: _MultiplierLP, weak: tuple[Multipliers, float], zero: float) -> tuple[str, Multipliers]:
    """The strongest of M, C, W for which multipliers exist; ``weak`` ones do, for W.

    A linear program that fails numerically decides nothing: the label is then weaker. Where the search of a
    stronger one ran out of nodes it is ``"at least C"`` or ``"at least W"``.
    """
    word = ""
    for name, pieces in _PIECES.items():
        multipliers, complete = _search(programs, weak, pieces, zero)
        if multipliers is not None:
            return word + name, multipliers
        word = word if complete else AT_LEAST
    return word + "W", weak[0]


def _search(
    programs: _MultiplierLP, weak: tuple[Multipliers, float], pieces: tuple[Piece, ...], zero: float
) -> tuple[Multipliers | None, bool]:
    """Depth-first search for multipliers that lie in one of ``pieces`` on every biactive pair, nearest first.

    It begins at ``weak`` ones. Also whether the search was complete.
    """
    stack: list[dict[int, Piece]] = [{}]
    n = np.count_nonzero(programs.lower < programs.upper)
    for _ in range(int(np.clip(_WORK / (n + 1), _LEAST_NODES, _NODES))):
        if not stack:
            return None, programs.decided
        node = stack.pop()
        solution = programs.solve(node) if node else weak
        if solution is None:
            continue
        G, H = solution[0].pairs[:, programs.pairs]
        outside = np.min([np.maximum(beyond(G, *a), beyond(H, *b)) for a, b in pieces], axis=0) > zero
        if not np.any(outside):
            return solution[0], True
        k = int(np.argmax(np.where(outside, np.minimum(np.abs(G), np.abs(H)), -1.0)))
        nearest = sorted(pieces, key=lambda piece: beyond(G[k], *piece[0]) + beyond(H[k], *piece[1]))
        stack.extend({**node, k: piece} for piece in reversed(nearest))
    return None, not stack and programs.decided
