"""A first guess of the active set of a contact solve, from the dual problem.

With the contact removed the stiffness is factorised once; the contact forces
``y = (lambda, tau)`` then minimise

    1/2 (F + B^T y)^T K^-1 (F + B^T y) + gamma . lambda    over    lambda >= 0, |tau| <= b,

B having the rows N and T: few unknowns in a box, and a product with the Hessian ``B K^-1 B^T``
is one back-substitution. The solution tells which nodes touch and which slide; the primal-dual
method makes it exact.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, factorised
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.newton import Evaluation, minimise

GAIN = 1e-10
"""Part of the gain so far below which a further decrease of the dual is not looked for.

Nodes at the edge of the contact say little, and each that is guessed wrong costs a factorisation.
"""

MAX_ITERATIONS = 20

EXACT = 1e-14
"""Residual of a linear solve, relative to the load, that needs no refinement."""

FEW = 20
"""Contact nodes below which guessing costs more than it saves; four times as many with friction."""


def first_set(system: ContactSystem) -> ActiveSet:
    """The active set that a cold contact solve begins with.

    With few contact nodes those with an initial gap of zero or less touch, and all stick. Where only
    contact holds the body all touch.
    """
    if system.rigid is not None:
        return ActiveSet(np.ones(system.offset.size, bool), np.zeros(system.slip_bound.size, dtype=np.int8))
    if system.offset.size >= FEW * (4 if system.slip_bound.size else 1):
        return predicted_set(system)
    return ActiveSet(system.offset <= 0, np.zeros(system.slip_bound.size, dtype=np.int8))


def touching_set(system: ContactSystem, touching: NDArray[np.bool_]) -> ActiveSet | None:
    """The active set of contact nodes (gaps,) that touched on a similar mesh; None where friction acts.

    Which nodes slide is then not known, and a guess of the whole set is better.
    """
    if system.slip_bound.size:
        return None
    return ActiveSet(np.array(touching), np.zeros(0, dtype=np.int8))


def predicted_set(system: ContactSystem) -> ActiveSet:
    """The active set that the dual solution suggests.

    The stiffness by itself must be regular: a body that only contact holds is not a valid problem.
    """
    n, bound = system.offset.size, system.slip_bound
    dual = DualEnergy(system)
    lower = np.concatenate([np.zeros(n), -bound])
    upper = np.concatenate([np.full(n, np.inf), bound])
    result = minimise(
        dual.evaluate,
        np.zeros(upper.size),
        lower,
        upper,
        tolerance=np.inf,
        gain_tolerance=GAIN,
        max_iterations=MAX_ITERATIONS,
    )
    force, friction = result.x[:n], result.x[n:]
    return ActiveSet(force > 0, np.where(np.abs(friction) >= bound, -np.sign(friction), 0).astype(np.int8))


class DualEnergy:
    """The dual function, and itself its Hessian.

    Parameters
    ----------
    system : ContactSystem
    slip : array, optional
        Slips at zero displacement, where displacements are counted from some other state.
    """

    def __init__(self, system: ContactSystem, slip: Array | None = None) -> None:
        frictional = system.slip_bound.size > 0
        rows = sp.vstack([system.normals, system.tangents]) if frictional else system.normals
        self._rows, self._columns = sp.csr_array(rows), sp.csr_array(rows.T)
        self._load = system.load
        at_rest = np.zeros(system.slip_bound.size) if slip is None or not frictional else slip
        self._gap = np.concatenate([system.offset, at_rest])
        self._stiffness, self._order = system.stiffness, system.order
        K = system.stiffness
        if system.order is not None:
            K = K[:, system.order][system.order]
        self._factor = factorised(K, ordered=system.order is not None)
        compliance = 1 / system.stiffness.diagonal()
        self._diagonal = self._rows.multiply(self._rows) @ compliance + 1e-3 * np.max(compliance)

    def displacement(self, y: Array) -> Array:
        """Displacement under the load and the contact forces."""
        return self._solved(self._load + self._columns @ y)

    def _solved(self, load: Array) -> Array:
        """Displacement under a load, without contact."""
        if self._order is None:
            return np.asarray(self._factor.solve(load))
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

    def evaluate(self, y: Array) -> Evaluation:
        """The dual function, gap and slip as its gradient."""
        u = self.displacement(y)
        value = 0.5 * float((self._load + self._columns @ y) @ u) + float(self._gap @ y)
        return Evaluation(value, self._rows @ u + self._gap, lambda: self)

    def __call__(self, d: Array) -> Array:
        """Gap and slip that contact forces ``d`` alone would make."""
        return np.asarray(self._rows @ self._solved(self._columns @ d))

    def diagonal(self) -> Array:
        """That of the Hessian, up to a factor that is much the same for all contact nodes."""
        return np.asarray(self._diagonal)
