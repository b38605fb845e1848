"""The lower level of a bilevel program: solved for a start, and checked at the end.

    y in argmin f(y; x, p)   subject to   lbx <= y <= ubx,   lbg <= g(y; x, p) <= ubg,

with the upper level's x fixed. KKT conditions hold at minima that satisfy a constraint qualification, but
at maxima and saddle points too: a point of the MPCC is one of the bilevel program only if the lower level is
at a minimum there.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, null_space

from rmesh_nlp.evaluation import ROUNDING, Array, Evaluator, Index, Mask, magnitude
from rmesh_nlp.optimize.activity import BOUND_OF_AN_NLP, ZERO
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import NLPResult, Solver

MOST = 200
"""Most variables of a lower level whose critical directions are searched."""

_FACES = 6  # most weakly active constraints for that
DENSE = 1000
"""Most variables of a lower level that is checked after each solve, by dense matrices: within a second."""


class Sides(NamedTuple):
    """One multiplier each: lower bounds of (y, g), then upper ones, then equal ones."""

    entry: Index
    """Entry of (y, g)."""
    sign: Array
    """-1 for lower bounds, else 1: its multiplier in CasADi's signs is ``sign * multiplier``."""
    bound: Array
    equal: Mask


SEARCHED = 20  # starts of a search for a lower value


@dataclass(frozen=True)
class LowerLevelCheck:
    """Whether a point of the MPCC is a minimum of the lower level with the upper level's variables fixed.

    Attributes
    ----------
    verdict : str
        ``global minimum``, ``local minimum``, ``undecided``, ``no minimum`` or ``not stationary``, by the
        second-order conditions of Nocedal and Wright, *Numerical Optimization* (2006), theorems 12.5 and
        12.6. Global: f is a convex quadratic and g linear in the lower level's variables. Negative curvature
        disproves a minimum only if multipliers are unique or do not enter it.
    f : float
        The lower level's objective.
    residual : float
        Largest residual of its KKT conditions, relative to 1 and to the largest term of the Lagrangian's
        gradient, and to ``1 + |bound|``.
    curvature_low, curvature_high : float
        Bounds of the least curvature of the Lagrangian along critical directions: its least eigenvalue on the
        null space of the strongly active constraints, and along the critical directions that were found.
        Equal if no constraint is weakly active, infinite if no direction is left.
    lower : array, optional
        Variables of the lower level with a lower value, if a search was asked for and has found them.
    searched : int
        From how many starts it was searched; 0 if it was not, or is convex.
    """

    verdict: str
    f: float
    residual: float
    curvature_low: float
    curvature_high: float
    lower: Array | None = None
    searched: int = 0

    def __str__(self) -> str:
        said = self.verdict + ("" if self.lower is None else ", a lower value was found")
        said += f", nothing lower from {self.searched} starts" if self.searched and self.lower is None else ""
        low, high = (f"{value:.3g}" for value in (self.curvature_low, self.curvature_high))
        if low == "inf":  # constraints leave no direction
            return f"{said}, a vertex of the constraints"
        return f"{said}, least curvature {low if low == high else f'between {low} and {high}'}"


@dataclass(frozen=True, eq=False)
class LowerLevel:
    """The lower level of an MPCC that :func:`rmesh_nlp.mpcc.bilevel` has made.

    Attributes
    ----------
    nlp : NLP
        Unknowns y; parameters (x, p), the upper level's variables first. Both are pure symbols.
    n_upper : int
        Number of the upper level's variables.
    """

    nlp: NLP
    n_upper: int

    @cached_property
    def sides(self) -> Sides:
        """The finite bounds of y and g."""
        lower, upper = np.append(self.nlp.lbx, self.nlp.lbg), np.append(self.nlp.ubx, self.nlp.ubg)
        fixed = lower == upper
        kind, entry = np.nonzero([np.isfinite(lower) & ~fixed, np.isfinite(upper) & ~fixed, fixed])
        sign = np.where(kind == 0, -1.0, 1.0)
        return Sides(entry, sign, np.where(kind == 0, lower[entry], upper[entry]), kind == 2)

    @property
    def size(self) -> int:
        """Number of unknowns of the MPCC: x, y and a multiplier for each side."""
        return self.n_upper + self.nlp.n_x + self.sides.entry.size

    def split(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Of unknowns of the MPCC the upper level's, the lower level's, and a multiplier for each side."""
        upper, y, multipliers = np.split(
            np.ravel(x)[: self.size], [self.n_upper, self.n_upper + self.nlp.n_x]
        )
        return upper, y, multipliers

    def solve(self, x: ArrayLike, y0: ArrayLike = 0.0, *, p: ArrayLike = ()) -> NLPResult:
        """Solve the lower level by Ipopt with the upper level's variables ``x``.

        Parameters
        ----------
        x : array_like
            Values of the upper level's variables.
        y0 : array_like
            Start; a scalar fills it. Ipopt moves it into the bounds.
        p : array_like
            Values of the parameters.
        """
        return self._solver(np.full(self.nlp.n_x, y0, dtype=float), p=np.append(x, p))

    def lowest(
        self, x: ArrayLike, y0: ArrayLike = 0.0, *, p: ArrayLike = (), n: int = SEARCHED, seed: int = 0
    ) -> NLPResult:
        """The lowest of ``n`` solutions of the lower level, from ``y0`` and from seeded random starts.

        A second-order check cannot tell a local minimum from a global one: compare ``f`` with that of
        :meth:`check`. Starts are uniform between the bounds, or within 10 of ``y0`` where there are none.
        """
        centre = np.full(self.nlp.n_x, y0, dtype=float)
        lower = np.where(np.isfinite(self.nlp.lbx), self.nlp.lbx, centre - 10)
        upper = np.where(np.isfinite(self.nlp.ubx), self.nlp.ubx, centre + 10)
        drawn = np.random.default_rng(seed).uniform(lower, np.maximum(lower, upper), (n - 1, centre.size))
        ends = [self.solve(x, start, p=p) for start in (centre, *drawn)]
        return min(ends, key=lambda end: (not end.converged, end.f))

    def start(
        self, x: ArrayLike, y0: ArrayLike = 0.0, *, p: ArrayLike = (), multipliers: float | None = None
    ) -> Array:
        """All unknowns of the MPCC at a solution of the lower level: ``x``, y, multipliers.

        Parameters
        ----------
        x, y0, p : array_like
            As of :meth:`solve`. If Ipopt fails, y is where it stopped.
        multipliers : float, optional
            Of all inequalities. By default those of the solution, so that the start satisfies all constraints
            of the lower level and all pairs. It then lies on one branch, and homotopies that begin there end
            at poorer minima; a start for x alone is completed with 1.
        """
        solution, sides = self.solve(x, y0, p=p), self.sides
        signed = sides.sign * np.append(solution.lam_x, solution.lam_g)[sides.entry]
        own = np.maximum(signed, 0.0) if multipliers is None else multipliers
        return np.concatenate([np.ravel(x), solution.x, np.where(sides.equal, signed, own)])

    def check(self, x: ArrayLike, *, p: ArrayLike = (), search: bool = False) -> LowerLevelCheck:
        """Whether the lower level is at a minimum.

        Parameters
        ----------
        x : array_like
            A point of the MPCC, such as ``result.x``.
        p : array_like
            Values of the parameters.
        search : bool
            Whether :meth:`lowest` looks for a lower value, if the lower level is not convex.
        """
        n_y, n_g, (entry, sign, bound, equal) = self.nlp.n_x, self.nlp.n_g, self.sides
        upper, y, multiplier = self.split(x)
        parameters, lam = np.append(upper, p), np.zeros(n_y + n_g)
        np.add.at(lam, entry, sign * multiplier)
        f, slope, g, jacobian, hessian = self._derivatives(y, parameters, lam[n_y:])
        rows = np.vstack([np.eye(n_y), jacobian.reshape(n_g, n_y, order="F")])
        unit = max(1.0, magnitude(slope))
        room = sign * (bound - np.append(y, g)[entry]) / (1 + np.abs(bound))
        terms = max(unit, magnitude(np.abs(rows.T) @ np.abs(lam)))
        kkt = [(slope + rows.T @ lam) / terms, np.where(equal, room, np.minimum(room, multiplier / unit))]
        residual = magnitude(np.concatenate(kkt))
        active = room <= BOUND_OF_AN_NLP
        strong = active & (equal | (multiplier > ZERO * unit))
        # curvatures have no sign below that of rounding, or below what they change by in a small step
        beside = self._derivatives(y + ZERO * (1 + np.abs(y)), parameters, lam[n_y:])[4]
        flat = max(magnitude(np.nan_to_num(beside - hessian)), ZERO * magnitude(hessian))
        matrix, gradients = hessian.reshape(n_y, n_y, order="F"), sign[:, None] * rows[entry]
        low, _ = least_eigenvalue(matrix, directions(gradients[strong]))
        high = least_critical(matrix, gradients[strong], gradients[active & ~strong])
        is_quadratic, is_linear = self._shape
        is_convex = is_quadratic and is_linear and least_eigenvalue(matrix, np.eye(n_y))[0] >= -flat
        lowest, searched = None, SEARCHED if search and not is_convex else 0
        if searched:
            end = self.lowest(upper, y, p=p)
            lowest = end.x if end.converged and end.f < f[0] - ZERO * (1 + abs(f[0])) else None
        if not residual <= ZERO:
            verdict = "not stationary"
        elif is_convex:
            verdict = "global minimum"
        elif lowest is not None:
            verdict = "no minimum"
        elif low > flat:
            verdict = "local minimum"
        else:
            unique = directions(gradients[active]).shape[1] == n_y - np.count_nonzero(active)
            verdict = "no minimum" if high < -flat and (unique or is_linear) else "undecided"
        return LowerLevelCheck(verdict, float(f[0]), residual, low, high, lowest, searched)

    @cached_property
    def _solver(self) -> Solver:
        return Solver(self.nlp)

    @cached_property
    def _derivatives(self) -> Evaluator:
        """``(y, (x, p), lam_g) -> f, its gradient, g, its Jacobian, Hessian of f + lam_g^T g``, dense."""
        y, p, f, g = self.nlp.x, self.nlp.p, self.nlp.f, self.nlp.g
        lam = type(y).sym("lam_g", self.nlp.n_g)
        hessian, _ = ca.hessian(f + ca.dot(lam, g), y)
        values = [f, ca.gradient(f, y), g, ca.jacobian(g, y), hessian]
        return Evaluator(ca.Function("lower", [y, p, lam], [ca.densify(value) for value in values]))

    @cached_property
    def _shape(self) -> tuple[bool, bool]:
        """Whether f is quadratic in y, and whether g is linear."""
        y, f, g = self.nlp.x, self.nlp.f, self.nlp.g
        bent = (ca.which_depends(column, y, 2, True) for column in (ca.densify(ca.gradient(f, y)), g))
        quadratic, linear = (not any(rows) for rows in bent)
        return quadratic, linear


def directions(gradients: Array) -> Array:
    """Orthonormal columns that span the directions along which no constraint changes."""
    if not len(gradients):  # older versions of SciPy refuse a matrix without rows
        return np.eye(gradients.shape[1])
    return null_space(gradients, rcond=ROUNDING)


def least_eigenvalue(matrix: Array, directions: Array) -> tuple[float, Array]:
    """Least eigenvalue of the matrix on the span of orthonormal directions, and its vector.

    Infinite if there are no directions.
    """
    if directions.shape[1] == 0:
        return np.inf, np.zeros(directions.shape[0])
    values, vectors = eigh(directions.T @ matrix @ directions, subset_by_index=(0, 0))
    return float(values[0]), directions @ vectors[:, 0]


def least_critical(matrix: Array, strong: Array, weak: Array) -> float:
    """Least curvature found along d with ``strong d = 0``, ``weak d <= 0``.

    The least one is attained inside a face of the cone, at an eigenvector there. With few weakly active
    constraints all faces are searched, of each its least eigenvector; else that of all active constraints.
    """
    n, least = weak.shape[0], np.inf
    few = n <= _FACES and matrix.shape[0] <= MOST
    for face in itertools.product((False, True), repeat=n) if few else [(True,) * n]:
        value, d = least_eigenvalue(matrix, directions(np.vstack([strong, weak[list(face)]])))
        if any(np.all(weak @ side <= ROUNDING) for side in (d, -d)):
            least = min(least, value)
    return least
