"""Second derivatives of the reduced energy L(q), as products with a vector.

With the active set of the contact solution held, and Lambda the Lagrangian of the energy program,

    L'' d = Lambda_qq d + Lambda_qu u' + Lambda_qs s' - gamma_q^T lambda',

where ``u', s', lambda'`` are the first-order changes of displacement, slip and contact force when
the nodes move along d: one more solve with the factorised stiffness of the contact solve.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Block, Evaluator, Symmetric, numbered
from rmesh_nlp.reduced import ReducedEnergy, ReducedPoint
from rmesh_nlp.sensitivity import tangent_response


class Curvature:
    """Evaluates L'' at contact solutions of one problem.

    Parameters
    ----------
    energy : ReducedEnergy
    """

    def __init__(self, energy: ReducedEnergy) -> None:
        self.energy = energy
        rel = energy.relocation
        hessian, jacobian = rel.derivatives.hess_lag, rel.derivatives.jac_g
        self._hessian, self._jacobian = Evaluator(hessian), Evaluator(jacobian)
        q, u, s = (slice(a, b) for a, b in pairwise(np.cumsum([0, rel.n_q, rel.n_u, rel.n_s])))
        upper = numbered(hessian.sparsity_out(0))
        self._qq = Symmetric(upper, rel.n_q)
        self._qu, self._qs = Block(upper, q, u), Block(upper, q, s)
        self._gap = Block(numbered(jacobian.sparsity_out(1)), rel.gap_rows, q)

    def at(self, point: ReducedPoint) -> Hessian:
        """L'' at a point, ready for products."""
        x = self.energy.point(point.q, point.equilibrium)
        rows = np.zeros(self.energy.relocation.nlp.n_g)
        rows[self.energy.relocation.gap_rows] = -point.equilibrium.normal_force
        (values,) = self._hessian(x, [], 1.0, rows)
        _, gap = self._jacobian(x, [])
        return Hessian(point, self._qq(values), self._qu(values), self._qs(values), self._gap(gap))


class Hessian:
    """L'' at one point; ``products`` counts its applications."""

    def __init__(
        self,
        point: ReducedPoint,
        qq: sp.csc_array,
        qu: sp.csc_array,
        qs: sp.csc_array,
        gap: sp.csc_array,
    ) -> None:
        self.qq = qq.T  # the same matrix, but by rows: a product takes half the time
        self._qu, self._qs, self._gap = qu, qs, gap
        self._uq, self._sq, self._gap_q = qu.T, qs.T, gap.T
        self._system, self._active = point.system, point.equilibrium.active
        self._respond = tangent_response(point.system, self._active)
        self.products = 0

    def diagonal(self) -> Array:
        """Size of the diagonal of Lambda_qq, kept away from zero."""
        diagonal = np.abs(self.qq.diagonal())
        return np.maximum(diagonal, 1e-3 * np.max(diagonal, initial=1e-300))

    def __call__(self, d: Array) -> Array:
        """``L'' d``."""
        self.products += 1
        out_of_balance = self._uq @ d
        frictional = self._system.slip_bound.size > 0
        if frictional:
            sliding = self._active.sliding
            out_of_balance = out_of_balance + self._system.tangents.T @ (sliding * (self._sq @ d))
        u, force = self._respond(out_of_balance, self._gap @ d)
        result = self.qq @ d + self._qu @ u - self._gap_q @ force
        if frictional:
            result += self._qs @ (sliding * (self._system.tangents @ u))
        return np.asarray(result)
