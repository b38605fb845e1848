"""Second derivatives of any outer objective F(X, u(X)), as products with a vector.

With the active set of the contact solution held, displacement, slip and forces y are a smooth function
of the moves q, given by as many equations C(q, y) = 0: equilibrium, and of each pair the member that is
zero. With the adjoint multipliers nu, ``C_y^T nu = -F_y``, and the Lagrangian ``Lambda = F + nu^T C``,

    F' = F_q + C_q^T nu,      F'' d = Lambda_qq d + Lambda_qy y' + C_q^T nu',
    C_y y' = -C_q d,          C_y^T nu' = -(Lambda_yq d + Lambda_yy y'),

one factorisation of C_y and two solves with it for each product (the second-order adjoint).
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from rmesh_nlp.evaluation import Array, Evaluator, Symmetric, numbered
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.models.kkt_program import bilevel
from rmesh_nlp.models.reduced import ReducedEnergy, ReducedPoint


class ObjectiveCurvature:
    """Evaluates F'' at contact solutions of one problem.

    Parameters
    ----------
    energy : ReducedEnergy
    objective : Objective
    """

    def __init__(self, energy: ReducedEnergy, objective: Objective) -> None:
        start = energy(np.zeros(energy.relocation.n_q))
        self._program = bilevel(
            energy.relocation.problem,
            objective,
            length=float(np.max(np.abs(start.equilibrium.u), initial=0.0)) or 1.0,
            force=start.system.force_scale or 1.0,
        )
        mpcc = self._program.mpcc
        assert mpcc.derivatives is not None
        assert mpcc.derivatives.hess_lag is not None
        self._kept = mpcc.derivatives
        self._n_g, self._n_pairs = mpcc.n_g, mpcc.n_pairs
        self._equations = np.flatnonzero(np.asarray(mpcc.lbg) == np.asarray(mpcc.ubg))
        self._gradient = Evaluator(mpcc.derivatives.grad_f)
        self._jacobian = Evaluator(mpcc.derivatives.jac_g)
        self._hessian = Evaluator(mpcc.derivatives.hess_lag)
        self._jacobian_at = _coordinates(mpcc.derivatives.jac_g.sparsity_out(1))
        self._symmetric = Symmetric(numbered(mpcc.derivatives.hess_lag.sparsity_out(0)))

    def at(self, point: ReducedPoint) -> ObjectiveHessian:
        """F'' at a point, ready for products."""
        x = self._program.point(point.q, point.equilibrium, point.system)
        values, nonzeros = self._jacobian(x, [])
        G, H = np.split(values[self._n_g :], 2)
        first = self._n_g + np.arange(self._n_pairs)
        held = np.concatenate([self._equations, np.where(G <= H, first, first + self._n_pairs)])
        jacobian = sp.csr_matrix((nonzeros, self._jacobian_at), shape=(values.size, x.size))[held]
        n_q = self._program.n_q
        of_q, of_y = jacobian[:, :n_q].tocsr(), jacobian[:, n_q:].tocsc()
        factors = splu(of_y)
        _, slope = self._gradient(x, [])
        nu = factors.solve(-slope[n_q:], "T")
        multipliers = np.zeros(values.size)
        multipliers[held] = nu
        (curvature,) = self._hessian(x, [], 1.0, multipliers)
        return ObjectiveHessian(
            slope[:n_q] + of_q.T @ nu, sp.csr_matrix(self._symmetric(curvature)), of_q, factors
        )


class ObjectiveHessian:
    """F'' at one point.

    Attributes
    ----------
    gradient : (n_q,) array
        F', by the same adjoint.
    """

    def __init__(
        self, gradient: Array, lagrangian: sp.csr_matrix, of_q: sp.csr_matrix, factors: splu
    ) -> None:
        self.gradient = gradient
        n_q = gradient.size
        self.qq = lagrangian[:n_q, :n_q]
        self._qy, self._yy = lagrangian[:n_q, n_q:], lagrangian[n_q:, n_q:]
        self._yq = self._qy.T.tocsr()
        self._of_q, self._of_q_t, self._factors = of_q, of_q.T.tocsr(), factors

    def diagonal(self) -> Array:
        """Size of the diagonal of Lambda_qq, kept away from zero."""
        diagonal = np.abs(self.qq.diagonal())
        return np.maximum(diagonal, 1e-3 * np.max(diagonal, initial=1e-300))

    def __call__(self, d: Array) -> Array:
        """``F'' d`` for a vector (n,), or for each column of a matrix (n, k)."""
        y = -self._factors.solve(self._of_q @ d)
        nu = -self._factors.solve(self._yq @ d + self._yy @ y, "T")
        return np.asarray(self.qq @ d + self._qy @ y + self._of_q_t @ nu)


def _coordinates(sparsity: ca.Sparsity) -> tuple[Array, Array]:
    rows, columns = sparsity.get_triplet()
    return np.asarray(rows), np.asarray(columns)
