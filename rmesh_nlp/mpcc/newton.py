"""Newton's method with active sets, for ends next to a known point; and what a solution changes by.

Each step solves the KKT system of the rows, bounds and members of pairs that count as active. Then the sets
follow the signs, as in the primal-dual active set strategy: a bound that is violated becomes active, an
active one whose multiplier has the wrong sign does not stay so (M. Hintermueller, K. Ito, K. Kunisch, SIAM J.
Optim. 13 (2002) 865-888). Of a pair one member is zero. Where the other one becomes negative both are, unless
the multiplier of the first says that it shall grow. Of two zero members the one with the larger positive
multiplier is let go. So the signs at an end are those of S. Where the pairs determine the rest, as in an
obstacle problem, it moves the contact boundary.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from rmesh_nlp.evaluation import Array, Mask, is_finite, magnitude
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.lpec import Linearisation, linearise
from rmesh_nlp.mpcc.run import Run, Warm
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

_STEPS = 25  # re-solves of 60 pairs took at most 11
# of rows and unknowns on the diagonal, since rows may depend on each other; refinement takes them out again
_SHIFTS = -1e-8, 1e-7
_PASSES = 3  # of refinement
_SMALL = 1e-6  # change of the unknowns, relative, after which the next one is rounding
_BEYOND = 1e-10  # violation of a bound that is rounding


class System:
    """The factorised KKT system at a point, with some unknowns and rows active.

    Whether the point ``is_minimum`` is None where that is not known. Solutions of a singular one are NaN.
    """

    def __init__(self, lifted: Lifted, z: Array, p: Array, lam_rows: Array, active: Mask) -> None:
        evaluate, at = lifted.kkt
        self.gradient, self.rows, values = evaluate(z, p, lam_rows)
        self.whole = sp.csc_array((values, at.indices, at.indptr), shape=at.shape)
        is_row = np.arange(active.size) >= z.size
        self.free = active == is_row  # of what is not the equation is that its change is zero
        kept = self.free[at.indices] & np.repeat(self.free, np.diff(at.indptr))
        free = sp.csc_array((np.where(kept, values, 0.0), at.indices, at.indptr), shape=at.shape)
        matrix = free + sp.diags(np.where(self.free, np.where(is_row, *_SHIFTS), 1.0))
        self.factors: SuperLU | None = None
        self.is_minimum: bool | None = None
        if not is_finite(values):
            return
        with suppress(RuntimeError):  # singular
            factors = splu(
                matrix.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
            self.factors = factors
            # permutations of rows and columns alike, so that pivots have the signs of eigenvalues
            if np.array_equal(factors.perm_r, factors.perm_c):
                self.is_minimum = bool(np.sum(factors.U.diagonal() < 0) == np.sum(is_row & active))

    def solve(self, right: Array, given: Array) -> Array:
        """Changes of the unknowns, those ``given`` where they are active, and multipliers of the rows."""
        if self.factors is None:
            return np.full(given.shape, np.nan)
        answer = np.where(self.free, 0.0, given)
        for _ in range(_PASSES):
            answer += self.factors.solve(np.where(self.free, right - self.whole @ answer, 0.0))
        return answer


def newton(run: Run, z: Array, warm: Warm) -> NLPResult | None:
    """Solve from the solution of a neighbouring problem; None if that leads to no minimum with signs of S."""
    lifted, nlp, watch = run.lifted, run.lifted.nlp, Budget()
    if lifted.base.hess_lag is None:
        return None
    n, pairs, weak = nlp.n_x, lifted.pairs, run.options.stationarity
    lower, upper = np.append(nlp.lbx, nlp.lbg), np.append(nlp.ubx, nlp.ubg)
    equal, lam = lower == upper, np.zeros(lower.size)
    if warm is not None:
        lam = np.append(warm[0], warm[1][: nlp.n_g])
    value = np.where(equal, lower, 0.0)  # of what is active at neither of these bounds
    lower[equal], lower[pairs], upper[equal] = -np.inf, -np.inf, np.inf
    strong = (np.abs(lam[pairs]) > weak) & (z < upper[:n] - z)[pairs]
    zero = np.where(np.any(strong, axis=0), strong, lifted.smaller(z))
    side = 1 * (np.isfinite(upper) & (lam > weak)) - (np.isfinite(lower) & (lam < -weak))
    limit = run.budget.iterations_left
    for k in range(1, 1 + (_STEPS if limit is None else min(_STEPS, limit))):
        side[pairs[zero]] = 0
        active = equal | (side != 0)
        active[pairs[zero]] = True
        system = System(lifted, z, run.p, lam[n:], active)
        if system.factors is None:
            return None
        at = np.append(z, system.rows)
        change = np.where(active, np.choose(side + 1, [lower, value, upper]) - at, 0.0)
        right = np.append(-system.gradient, change[n:])
        answer = system.solve(right, change * (np.arange(at.size) < n))
        product = system.whole @ answer
        lam = np.append((right - product)[:n] * active[:n], answer[n:])
        at += np.append(answer[:n], product[n:])
        if not is_finite(at):
            return None
        z, before = at[:n], (side, zero)
        outside = 1 * (at > upper + _BEYOND) - (at < lower - _BEYOND)
        side = np.where(side, side * (side * lam > -weak), outside)
        below, risen = at[pairs] < -_BEYOND, np.where(lam > weak, lam, 0.0)[pairs]
        both = np.all(zero, axis=0) & (risen >= np.max(risen, axis=0))
        zero = (zero | below) & ~(zero & (risen > 0) & (both | below[::-1]))
        is_same = all(map(np.array_equal, before, (side, zero)))
        if is_same and magnitude(answer[:n]) <= _SMALL * (1 + magnitude(z)):
            rows, _ = lifted.jacobian(z, run.p)
            ended = NLPResult(
                z, run.objective(z), rows, lam[:n], lam[n:], Status.CONVERGED, k, {}, watch.elapsed
            )
            return ended if system.is_minimum else None
    return None


def along_active(
    run: Run, z: Array, lin: Linearisation, lam_z: Array, lam_rows: Array, strong: bool = False
) -> tuple[System, bool]:
    """The KKT system of a solution, perhaps only with what has a multiplier; and whether all has one.

    Of a pair that is not biactive the side needs none.
    """
    pairs, n = run.lifted.pairs, z.size
    active, kept = (np.roll(mask, n) for mask in (lin.lower | lin.upper, lin.lower & lin.upper))
    active[pairs[lin.zero]] = True
    kept[pairs[lin.zero & ~lin.zero[::-1]]] = True
    kept |= np.abs(np.append(lam_z, lam_rows)) > run.options.stationarity * lin.scale
    own = active & kept if strong else active
    return System(run.lifted, z, run.p, lam_rows, own), not np.any(active & ~kept)


def curvature(run: Run, z: Array, lin: Linearisation, lam_z: Array, lam_rows: Array) -> str:
    """``not negative``, ``negative`` or ``not tested``: that of the Lagrangian along what is active.

    Where something active has no multiplier, directions along which it changes decide nothing.
    """
    system, is_strict = along_active(run, z, lin, lam_z, lam_rows, strong=True)
    if system.is_minimum:
        return "not negative"
    if system.is_minimum is not None and not is_strict:
        system, _ = along_active(run, z, lin, lam_z, lam_rows)
    return "negative" if system.is_minimum is False else "not tested"


def sensitivity(run: Run, z: Array, lam_z: Array, lam_rows: Array) -> Array:
    """Derivatives of a solution (n_z, n_p); NaN where strict complementarity or the second order fails."""
    lin = linearise(run.lifted, z, run.p, run.options.activity, run.options.corner)
    system, is_strict = along_active(run, z, lin, lam_z, lam_rows)
    cross = run.lifted.cross(z, run.p, lam_rows).full()
    if not (is_strict and system.is_minimum):
        return np.full((z.size, cross.shape[1]), np.nan)
    none = np.zeros(len(cross))
    return np.column_stack([system.solve(-column, none)[: z.size] for column in cross.T])
