"""Second derivatives of the reduced energy L(q), as products with a vector.

With the active set of the contact solution held, and Lambda the Lagrangian of the energy program,

    L'' d = Lambda_qq d + Lambda_qu u' + Lambda_qs s' - gamma_q^T lambda' - sigma_q^T tau',

where ``u', s', lambda', tau'`` are the first-order changes of displacement, slip, normal and tangential
contact force when the nodes move along d: one more solve with the factorised stiffness of the contact
solve. The slips at fixed displacement, sigma, move where a foundation is curved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.sensitivity import TangentResponse
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import Index
from rmesh_nlp.models.blocks import Blocks, SecondDerivatives
from rmesh_nlp.models.reduced import ReducedEnergy, ReducedPoint


class Curvature:
    """Evaluates L'' at contact solutions of one problem.

    Parameters
    ----------
    energy : ReducedEnergy
    rule : int, optional
        See :class:`~rmesh_nlp.models.blocks.SecondDerivatives`; None for exact second derivatives.
    """

    def __init__(self, energy: ReducedEnergy, rule: int | None = None) -> None:
        self._energy, self._derivatives = energy, SecondDerivatives(energy.relocation, rule)

    def at(self, point: ReducedPoint) -> Hessian:
        """L'' at a point, ready for products."""
        x = self._energy.point(point.q, point.equilibrium)
        rows = self._energy.relocation.friction_rows
        return Hessian(point, self._derivatives(x, point.equilibrium), rows)


DENSE = 200
"""Moves up to which all products are formed at once: one solve with as many right sides costs less than the
products of a step one by one (7 against 25 on Example 6.1 with 126 moves; as much with 286)."""


@dataclass(frozen=True)
class Lifted:
    """L'' as a Schur complement, ``moves - mixed^T stiffness^-1 mixed``, all three of them sparse.

    Where the change of a displacement is known from the moves, at touching and at sticking nodes, it is put
    in; what is left is the stiffness over the displacements that contact leaves free.

    Attributes
    ----------
    moves : (n_q, n_q) sparse array
    mixed : (free, n_q) sparse array
    stiffness : (free, free) sparse array
    free : (free,) int array
        Numbers of these displacements, in the coordinates of the contact system.
    n_u : int
        Number of all displacements.
    """

    moves: sp.csc_array
    mixed: sp.csc_array
    stiffness: sp.csc_array
    free: Index
    n_u: int


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
        self._sliding = (
            self._active.sliding[friction_rows].astype(float) if friction_rows.size else np.zeros(0)
        )
        self._respond = TangentResponse(point.system, self._active)
        self._rotated = point.system.rotated
        self._whole: Array | None = None

    def diagonal(self) -> Array:
        """Size of the diagonal of Lambda_qq, kept away from zero."""
        diagonal = np.abs(self.qq.diagonal())
        return np.maximum(diagonal, 1e-3 * np.max(diagonal, initial=1e-300))

    def lifted(self) -> Lifted:
        """The sparse matrix in moves and displacements whose Schur complement is L''."""
        rotated, active = self._rotated, self._active
        mixed = self._uq
        moves = self.qq
        n_contact, n_q = active.touching.size, moves.shape[0]
        slip = sp.csr_array((n_contact, n_q))
        if self._rows.size:
            at_contact = sp.csr_array(
                (np.ones(self._rows.size), (self._rows, np.arange(self._rows.size))),
                shape=(n_contact, self._rows.size),
            )
            slip = sp.csr_array(at_contact @ self._slip)
            friction = self._qs @ sp.diags_array(self._sliding)
            mixed = mixed + self._tangents.T @ friction.T
            moves = moves + friction @ self._slip + (friction @ self._slip).T
        if rotated.basis is not None:
            mixed = rotated.basis.T @ mixed
        mixed = sp.csr_array(mixed)
        held, by_moves = self._respond.held, sp.csr_array(self._respond.held_by(self._gap, slip))
        inside, _ = rotated.factor(active)
        stiffness = sp.csr_array(rotated.K)
        coupled = by_moves.T @ mixed[held]
        moves = moves - coupled - coupled.T + by_moves.T @ stiffness[held][:, held] @ by_moves
        mixed = mixed[inside] - stiffness[inside][:, held] @ by_moves
        corner = rotated.K[:, inside][inside]
        return Lifted(sp.csc_array(moves), sp.csc_array(mixed), corner, inside, rotated.F.size)

    def joint(self, width: Array) -> tuple[sp.csc_array, int]:
        """The matrix of :meth:`lifted` with the moves in units of ``width``.

        Returns
        -------
        matrix : sparse array
        n : int
            The first n unknowns are the moves.
        """
        lifted, scale = self.lifted(), sp.diags_array(width)
        mixed = lifted.mixed @ scale
        matrix = sp.block_array([[scale @ lifted.moves @ scale, mixed.T], [mixed, lifted.stiffness]])
        return sp.csc_array(matrix), width.size

    def __call__(self, d: Array) -> Array:
        """``L'' d`` for a vector (n,), or for each column of a matrix (n, k)."""
        if d.ndim == 1 and d.size <= DENSE:
            if self._whole is None:
                self._whole = self._products(np.eye(d.size))
            return np.asarray(self._whole @ d)
        return self._products(d)

    def _products(self, d: Array) -> Array:
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
