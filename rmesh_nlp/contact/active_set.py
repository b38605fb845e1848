"""The inner problem: contact on a fixed mesh, solved exactly by a primal-dual active set.

At fixed node positions the inner problem is a strictly convex quadratic program,

    min 1/2 u^T K u - F^T u + sum_i b_i |t_i . u_i|   with   gap = N u + gamma >= 0,

(5.1), (5.8), with Tresca bounds b_i = g omega_i >= 0. The active set (which nodes touch, which stick) is
found by a semismooth Newton method [1]_; when that does not make progress, single least-index changes [2]_
guarantee that no set is visited for ever. A cold solve guesses it from the dual problem: the contact forces
``y = (lambda, tau)`` minimise

    1/2 (F + B^T y)^T K^-1 (F + B^T y) + gamma . lambda    over    lambda >= 0, |tau| <= b,

B having the rows N and T: few unknowns in a box.

A body that contact holds, and not the given displacements alone, has rigid motions Z left. With f the work
of the load in them and A the change of the gaps, an equilibrium exists if every motion that opens no gap
into the foundation, ``A r >= 0``, is one that the load resists, ``f . r < 0``. It is unique if the nodes that
press on the foundation prevent every motion: two solutions differ by a rigid motion that keeps those closed.

.. [1] M. Hintermüller, K. Ito, K. Kunisch, The primal-dual active set strategy as a
   semismooth Newton method, SIAM J. Optim. 13 (2003) 865-888.
.. [2] J. J. Júdice, F. M. Pires, A block principal pivoting algorithm for large-scale
   strictly monotone linear complementarity problems, Comput. Oper. Res. 21 (1994) 587-596.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.optimize import linprog

from rmesh_nlp.contact.coulomb import newton
from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.next_set import holding, next_set, rank, single_change
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import Index
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.trust_region import Evaluation, minimise

MAX_ITERATIONS = 100
"""Factorisations that one contact solve may take."""

PATIENCE = 3
"""Block changes of the active set without fewer violations before single changes begin."""

GAIN, GAIN_FORMED = 1e-10, 1e-15
"""Part of the gain so far below which a further decrease of the dual is not looked for; the second one where
its Hessian is formed, for then iterations cost nothing beside another active set."""

DUAL_ITERATIONS, DUAL_ITERATIONS_FORMED = 20, 60

EXACT = 1e-14
"""Residual of a linear solve, relative to the load, that needs no refinement."""

FEW = 20
"""Contact nodes below which guessing costs more than it saves; four times as many with friction."""


DENSE = 8.0
"""The dual Hessian is formed where forces act on at most the root of this times the number of unknowns: along
a boundary, not on all of an interior. These unknowns are eliminated last: the trailing block of the factors,
inverted, gives the Hessian. On Example 6.1 with 448 squares a side 430 back-substitutions took 13 of the 15 s
of a cold solve; the factors have 7 % more entries."""

LEAST_PART = 1 / 16
"""Least part of a change of the bounds of friction that is taken."""


def solve(
    system: ContactSystem, start: ActiveSet | None = None, max_iterations: int = MAX_ITERATIONS
) -> Equilibrium:
    """Solve the contact system for its active set, from ``start`` or by default from :func:`first_set`.

    Gaps of touching nodes and slips of sticking nodes are zero up to rounding of the change of coordinates.
    If the status is not CONVERGED the last iterate is returned. Coulomb friction is solved by
    :mod:`rmesh_nlp.contact.coulomb`; where that fails, bounds that follow the contact forces are tried.
    """
    active = start or first_set(system)
    if system.coulomb is None:
        return _solved(system, active, max_iterations)
    state = newton(system, active, max_iterations)
    return state if state.status is Status.CONVERGED else _by_bounds(system, state, max_iterations)


def _by_bounds(system: ContactSystem, last: Equilibrium, max_iterations: int) -> Equilibrium:
    """Solutions for given bounds, which follow ``b + F lambda``, damped, until the active set is the one."""
    bound, part, before, spent = system.slip_bound, 1.0, np.inf, last.iterations
    for _ in range(max_iterations):
        tresca = replace(system, slip_bound=bound, coulomb=None)
        state = _solved(tresca, last.active, max_iterations)
        spent += state.iterations
        if state.status is not Status.CONVERGED:
            break
        last = system.equilibrium(state.active)
        if next_set(system, last, state.active)[1] == 0:
            return replace(last, iterations=spent)
        change = system.bound(state.normal_force) - bound
        size = float(np.max(np.abs(change)))
        part = part if size < before else max(part / 2, LEAST_PART)
        bound, before = bound + part * change, size
    return replace(last, status=Status.CYCLED, iterations=spent)


def _solved(system: ContactSystem, active: ActiveSet, max_iterations: int) -> Equilibrium:
    fewest, patience = np.inf, PATIENCE
    seen: set[bytes] = set()
    for iteration in range(1, max_iterations + 1):
        state = system.equilibrium(active)
        proposal, violations = next_set(system, state, active)
        if violations == 0:
            return replace(state, iterations=iteration)
        proposal = holding(system, active, state, proposal)
        if proposal.key() == active.key():  # nodes that pull are needed to hold the body
            return replace(state, status=Status.CYCLED, iterations=iteration)
        if violations < fewest:
            fewest, patience = violations, PATIENCE
            seen.clear()
        elif patience > 0:
            patience -= 1
        else:
            proposal = single_change(active, proposal)
            if proposal.key() in seen:
                return replace(state, status=Status.CYCLED, iterations=iteration)
            seen.add(proposal.key())
        active = proposal
    return replace(state, status=Status.ITERATION_LIMIT, iterations=max_iterations)


def first_set(system: ContactSystem) -> ActiveSet:
    """The active set that a cold contact solve begins with.

    With few contact nodes those with an initial gap of zero or less touch, and all stick. Where only
    contact holds the body all touch.
    """
    n, n_bounds = system.offset.size, system.slip_bound.size
    if system.rigid is None and n >= (4 * FEW if n_bounds else FEW):
        return predicted_set(system)
    touching = system.offset <= 0 if system.rigid is None else np.ones(n, bool)
    return ActiveSet(touching, np.zeros(n_bounds, dtype=np.int8))


def touching_set(system: ContactSystem, touching: NDArray[np.bool_]) -> ActiveSet | None:
    """The active set of contact nodes (gaps,) that touched on a similar mesh; None where friction acts."""
    return None if system.slip_bound.size else ActiveSet(np.array(touching), np.zeros(0, dtype=np.int8))


def predicted_set(system: ContactSystem) -> ActiveSet:
    """The active set that the dual solution suggests; the stiffness by itself must be regular."""
    n, bound = system.offset.size, system.slip_bound
    upper = np.concatenate([np.full(n, np.inf), bound])
    dual = DualEnergy(system)
    result = minimise(
        dual.evaluate,
        np.zeros(upper.size),
        np.concatenate([np.zeros(n), -bound]),
        upper,
        tolerance=np.inf,
        gain_tolerance=GAIN_FORMED if dual.is_formed else GAIN,
        max_iterations=DUAL_ITERATIONS_FORMED if dual.is_formed else DUAL_ITERATIONS,
    )
    force, friction = result.x[:n], result.x[n:]
    return ActiveSet(force > 0, np.where(np.abs(friction) >= bound, -np.sign(friction), 0).astype(np.int8))


class DualEnergy:
    """The dual function, and itself its Hessian; ``slip`` at zero displacement is zero by default."""

    def __init__(self, system: ContactSystem, slip: Array | None = None) -> None:
        frictional = system.slip_bound.size > 0
        rows = sp.vstack([system.normals, system.tangents]) if frictional else system.normals
        self._rows, self._columns = sp.csr_array(rows), sp.csr_array(rows.T)
        at_rest = np.zeros(system.slip_bound.size) if slip is None or not frictional else slip
        self._load, self._gap = system.load, np.concatenate([system.offset, at_rest])
        self._stiffness = K = system.stiffness
        last = np.unique(self._rows.indices)  # the unknowns that forces act on
        few = last.size**2 <= DENSE * self._load.size
        ordered = system.order is not None
        self._order = slice(None) if system.order is None else system.order
        if system.order is not None and few:
            first = system.order[np.isin(system.order, last, invert=True)]
            self._order = np.concatenate([first, last])
        self._factor = factorised(K[:, self._order][self._order] if ordered else K, ordered=ordered)
        self._compliance = self._dense(last, ordered) if few else None
        compliance = 1 / K.diagonal()
        self._diagonal = self._rows.multiply(self._rows) @ compliance + 1e-3 * np.max(compliance)

    @property
    def is_formed(self) -> bool:
        """Whether the Hessian is a dense matrix."""
        return self._compliance is not None

    def displacement(self, y: Array) -> Array:
        """Displacement under the load and the contact forces."""
        return self._solved(self._load + self._columns @ y)

    def _solved(self, load: Array) -> Array:
        """Displacement under a load, without contact."""
        u = np.empty_like(load)
        u[self._order] = self._factor.solve(load[self._order])
        return u

    def refined(self, y: Array) -> Array:
        """The same with a step of iterative refinement if that is worth while."""
        load = self._load + self._columns @ y
        u = self._solved(load)
        residual = load - self._stiffness @ u
        if np.max(np.abs(residual), initial=0.0) <= EXACT * np.max(np.abs(load), initial=0.0):
            return u
        return u + self._solved(residual)

    def _dense(self, last: Index, ordered: bool) -> Array | None:
        """Gaps and slips by contact forces, from the inverse of the stiffness at the unknowns they act on."""
        if not ordered:
            return np.asarray(self._rows @ self._factor.solve(self._columns.toarray()))
        trailing = self._factor.trailing(last.size)
        if trailing is None:
            return None
        rows = self._rows[:, last].toarray()
        return np.asarray(rows @ np.linalg.solve(trailing, rows.T))

    @cached_property
    def _unloaded(self) -> tuple[float, Array]:
        """The dual function and its gradient without contact forces."""
        u = self.displacement(np.zeros(self._gap.size))
        return 0.5 * float(self._load @ u), self._rows @ u + self._gap

    def evaluate(self, y: Array) -> Evaluation:
        """The dual function, gap and slip as its gradient."""
        if self._compliance is not None:
            value, gradient = self._unloaded
            change = self._compliance @ y
            return Evaluation(value + float((gradient + 0.5 * change) @ y), gradient + change, lambda: self)
        u = self.displacement(y)
        value = 0.5 * float((self._load + self._columns @ y) @ u) + float(self._gap @ y)
        return Evaluation(value, self._rows @ u + self._gap, lambda: self)

    def __call__(self, d: Array) -> Array:
        """Gap and slip that contact forces ``d`` alone would make."""
        if self._compliance is not None:
            return np.asarray(self._compliance @ d)
        return np.asarray(self._rows @ self._solved(self._columns @ d))

    def diagonal(self) -> Array:
        """That of the Hessian, up to a factor that is much the same for all contact nodes."""
        return np.asarray(self._diagonal)


def check_load(system: ContactSystem) -> None:
    """Raise a ProblemError if some rigid motion away from all foundations does not cost energy."""
    if system.rigid is None:
        return
    work, gaps = system.rigid.T @ system.load, system.normals @ system.rigid
    work = work / max(float(np.max(np.abs(work))), 1e-12 * system.force_scale)
    rows = np.vstack([-gaps, -work])
    for goal in np.vstack([np.eye(work.size), -np.eye(work.size)]):
        answer = linprog(goal, rows, np.zeros(len(rows)), bounds=[(-1, 1)] * work.size)
        if answer.status == 0 and -answer.fun > 1e-6:
            raise ProblemError(
                "dirichlet",
                "the body can move off its foundations as a rigid body, and the load does not press it on "
                "them: give displacements that hold it, or turn the load",
            )


def check_unique(system: ContactSystem, state: Equilibrium) -> None:
    """Raise a ProblemError if the nodes that press on the foundation leave a rigid motion."""
    if system.rigid is None:
        return
    length = np.max(np.abs(system.offset), initial=0.0) + np.max(np.abs(state.u), initial=0.0)
    rounding = 1e-12 * length * np.max(system.stiffness.diagonal(), initial=0.0)
    pressing = state.normal_force > max(1e-9 * np.max(state.normal_force, initial=0.0), rounding)
    if rank(system.normals @ system.rigid, pressing) < system.rigid.shape[1]:
        raise ProblemError(
            "dirichlet",
            "contact leaves a rigid-body mode unconstrained: the body can slide or turn on the nodes that "
            "press on the foundation; give one more displacement",
        )
