"""Second derivatives of the reduced energy L(q), as products with a vector.

With the active set of the contact solution held, and Lambda the Lagrangian of the energy program,

    L'' d = Lambda_qq d + Lambda_qu u' + Lambda_qs s' - gamma_q^T lambda' - sigma_q^T tau',

where ``u', s', lambda', tau'`` are the first-order changes of displacement, slip, normal and tangential
contact force when the nodes move along d: one more solve with the factorised stiffness of the contact
solve. The slips at fixed displacement, sigma, move where a foundation is curved.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.sensitivity import tangent_response
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import Index
from rmesh_nlp.programs.blocks import Blocks, SecondDerivatives
from rmesh_nlp.programs.reduced import ReducedEnergy, ReducedPoint


class Curvature:
    """Evaluates L'' at contact solutions of one problem.

    Parameters
    ----------
    energy : ReducedEnergy
    """

    def __init__(self, energy: ReducedEnergy) -> None:
        self._energy, self._derivatives = energy, SecondDerivatives(energy.relocation)

    def at(self, point: ReducedPoint) -> Hessian:
        """L'' at a point, ready for products."""
        x = self._energy.point(point.q, point.equilibrium)
        rows = self._energy.relocation.friction_rows
        return Hessian(point, self._derivatives(x, point.equilibrium), rows)


class Hessian:
    """L'' at one point."""

    def __init__(self, point: ReducedPoint, blocks: Blocks, friction_rows: Index) -> None:
        self.qq = blocks.qq.T  # the same matrix, but by rows: a product takes half the time
        self._qu, self._qs = blocks.qu, blocks.qs
        self._uq, self._sq, self._gap, self._gap_q = blocks.qu.T, blocks.qs.T, blocks.gap, blocks.gap.T
        self._slip, self._slip_q = blocks.slip, blocks.slip.T
        self._active = point.equilibrium.active
        self._rows = friction_rows
        self._tangents = point.system.tangents[friction_rows]
        self._sliding = self._active.sliding[friction_rows] if friction_rows.size else np.zeros(0)
        self._respond = tangent_response(point.system, self._active)
        self._rotated = point.system.rotated

    def diagonal(self) -> Array:
        """Size of the diagonal of Lambda_qq, kept away from zero."""
        diagonal = np.abs(self.qq.diagonal())
        return np.maximum(diagonal, 1e-3 * np.max(diagonal, initial=1e-300))

    def joint(self, width: Array) -> tuple[sp.csc_array, int]:
        """Second derivatives in moves, in units of ``width``, and displacements that contact leaves free.

        Its Schur complement in the moves is L'' where gaps and slips do not change with the moves and no
        node slides against friction; elsewhere it is close.

        Returns
        -------
        matrix : sparse array
        n : int
            The first n unknowns are the moves.
        """
        rotated, scale = self._rotated, sp.diags_array(width)
        inside, _ = rotated.factor(self._active)
        mixed = scale @ (self._qu if rotated.basis is None else self._qu @ rotated.basis)[:, inside]
        corner = rotated.K[:, inside][inside]
        return sp.csc_array(sp.block_array([[scale @ self.qq @ scale, mixed], [mixed.T, corner]])), width.size

    def __call__(self, d: Array) -> Array:
        """``L'' d`` for a vector (n,), or for each column of a matrix (n, k)."""
        sliding = self._sliding if d.ndim == 1 else self._sliding[:, None]
        out_of_balance, slip = self._uq @ d, np.zeros((self._active.touching.size, *d.shape[1:]))
        if sliding.size:
            bound = sliding * (self._sq @ d)  # change of the friction of sliding nodes
            out_of_balance = out_of_balance + self._tangents.T @ bound
            slip[self._rows] = self._slip @ d
        u, normal, tangential = self._respond(out_of_balance, self._gap @ d, slip)
        result = self.qq @ d + self._qu @ u - self._gap_q @ normal
        if sliding.size:
            result += self._qs @ (sliding * (self._tangents @ u + slip[self._rows]))
            result += self._slip_q @ (bound - tangential[self._rows])
        return np.asarray(result)
