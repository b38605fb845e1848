"""Second derivatives of the reduced energy L(q), as products with a vector.

With the active set of the contact solution held, and Lambda the Lagrangian of the energy program,

    L'' d = Lambda_qq d + Lambda_qu u' + Lambda_qs s' - gamma_q^T lambda',

where ``u', s', lambda'`` are the first-order changes of displacement, slip and contact force when
the nodes move along d: one more solve with the factorised stiffness of the contact solve.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Evaluator, Symmetric, pattern
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
        nlp = rel.nlp
        lam = ca.MX.sym("lam", rel.n_contact)
        rows = ca.vertcat(-lam, ca.MX.zeros(nlp.n_g - rel.n_contact))
        hessian = rel.derivatives.hess_lag(nlp.x, nlp.p, 1.0, rows)
        gap = rel.derivatives.jac_g(nlp.x, nlp.p)[1][rel.gap_rows, : rel.n_q]
        blocks = [hessian[: rel.n_q, : rel.n_q], hessian[: rel.n_q, rel.n_q :], gap]
        self._own = Symmetric(blocks[0].sparsity())
        self._patterns = [pattern(block.sparsity()) for block in blocks[1:]]
        self._evaluate = Evaluator(ca.Function("curvature", [nlp.x, lam], blocks))

    def at(self, point: ReducedPoint) -> Hessian:
        """L'' at a point, ready for products."""
        x = self.energy.point(point.q, point.equilibrium)
        own, *others = self._evaluate(x, point.equilibrium.normal_force)
        mixed, gap = (
            sp.csc_array((data, p.indices, p.indptr), shape=p.shape)
            for p, data in zip(self._patterns, others, strict=True)
        )
        return Hessian(self.energy, point, self._own(own), mixed, gap)


class Hessian:
    """L'' at one point; ``products`` counts its applications."""

    def __init__(
        self,
        energy: ReducedEnergy,
        point: ReducedPoint,
        qq: sp.csc_array,
        mixed: sp.csc_array,
        gap: sp.csc_array,
    ) -> None:
        rel = energy.relocation
        self.qq, self._gap = qq, gap
        self._qu, self._qs = mixed[:, : rel.n_u], mixed[:, rel.n_u :]
        self._uq, self._sq = self._qu.T, self._qs.T
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
        result = self.qq @ d + self._qu @ u - self._gap.T @ force
        if frictional:
            result += self._qs @ (sliding * (self._system.tangents @ u))
        return np.asarray(result)
