"""Second derivatives of the reduced model, as products with a vector.

Of the reduced energy L(q) (:class:`Curvature`): with the active set of the contact solution held, and Lambda
the Lagrangian of the energy NLP,

    L'' d = Lambda_qq d + Lambda_qu u' + Lambda_qs s' - gamma_q^T lambda' - sigma_q^T tau',

where ``u', s', lambda', tau'`` are the first-order changes of displacement, slip, normal and tangential
contact force when the nodes move along d: one more solve with the factorised stiffness of the contact
solve. The slips at fixed displacement, sigma, move where a foundation is curved.
Those of any other objective are of :mod:`rmesh_nlp.models.kkt_point`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.sensitivity import TangentResponse
from rmesh_nlp.evaluation import Array, Block, Index, Symmetric
from rmesh_nlp.models.kkt_point import ObjectiveHessian, positive
from rmesh_nlp.models.reduced_model import Reduced, ReducedEnergy, ReducedPoint

DENSE = 200
"""Outer variables up to which all products are formed at once: one solve with as many right sides costs less
than the products of a step one by one (7 against 25 on Example 6.1 with 126 of them; as much with 286)."""


@dataclass(frozen=True)
class Blocks:
    """Blocks of the Hessian of ``J - lambda . gap - tau . u_t`` in q, displacement u and slip s.

    ``gap`` (contact nodes, n_q) and ``slip`` (n_s, n_q) are the derivatives of the gaps and of the slips u_t
    by q; those of slips are zero where no foundation is curved.
    """

    qq: sp.csc_array
    qu: sp.csc_array
    qs: sp.csc_array
    gap: sp.csc_array
    slip: sp.csc_array


class Curvature:
    """Evaluates L'' at contact solutions of one problem; where blocks are in the whole is found once."""

    def __init__(self, energy: ReducedEnergy) -> None:
        self._energy, rel = energy, energy.relocation
        q, u, s = (
            slice(a, b) for a, b in pairwise(np.cumsum([0, rel.parts.n_q, rel.parts.n_u, rel.parts.n_s]))
        )
        upper, first = rel.assembled.second.pattern, rel.assembled.first.pattern
        self._second = Symmetric(upper, rel.parts.n_q), Block(upper, q, u), Block(upper, q, s)
        self._first = Block(first, rel.gap_rows, q), Block(first, rel.slip_rows, q)

    def at(self, point: ReducedPoint) -> Hessian:
        """L'' at a point, ready for products."""
        rel, solved = self._energy.relocation, point.equilibrium
        x, rows = self._energy.unknowns(point.q, solved.u), np.zeros(rel.n_rows)
        rows[rel.gap_rows] = -solved.normal_force
        if rel.parts.n_s:
            rows[rel.slip_rows] = -solved.tangential_force[rel.parts.friction_rows]
        (second,) = rel.assembled.second(x, None, np.ones(1), rows)
        *_, first = rel.assembled.first(x, None)
        blocks = [block(second) for block in self._second] + [block(first) for block in self._first]
        return Hessian(point, Blocks(*blocks), rel.parts.friction_rows)


@dataclass(frozen=True)
class Lifted:
    """L'' as a Schur complement, ``outer - mixed^T stiffness^-1 mixed``, all three of them sparse.

    Where the change of a displacement is known from that of q, at touching and at sticking nodes, it is put
    in; what is left is the stiffness over the displacements that contact leaves free, ``free`` their numbers
    in the coordinates of the contact system. ``n_u`` is the number of all displacements.
    """

    outer: sp.csc_array
    mixed: sp.csc_array
    stiffness: sp.csc_array
    free: Index
    n_u: int


class Hessian:
    """L'' at one point."""

    def __init__(self, point: ReducedPoint, blocks: Blocks, friction_rows: Index) -> None:
        self.qq = blocks.qq.T  # the same matrix, but by rows: a product takes half the time
        self._qu, self._qs, self._gap, self._slip = blocks.qu, blocks.qs, blocks.gap, blocks.slip
        self._uq, self._sq = blocks.qu.T, blocks.qs.T
        self._active, self._rows = point.equilibrium.active, friction_rows
        self._tangents = point.system.tangents[friction_rows]
        self._sliding = np.zeros(0)
        if friction_rows.size:
            self._sliding = self._active.sliding[friction_rows].astype(float)
        self._respond = TangentResponse(point.system, self._active)
        self._rotated = point.system.rotated
        self._whole: Array | None = None

    def diagonal(self) -> Array:
        """Size of the diagonal of Lambda_qq, kept away from zero."""
        return positive(self.qq.diagonal())

    def lifted(self) -> Lifted:
        """The sparse matrix in q and displacements whose Schur complement is L''."""
        rotated, active, mixed, outer = self._rotated, self._active, self._uq, self.qq
        n_contact = active.touching.size
        slip = sp.csr_array((n_contact, outer.shape[0]))
        if self._rows.size:
            slip = sp.csr_array(sp.csr_array(sp.eye_array(n_contact))[:, self._rows] @ self._slip)
            friction = self._qs @ sp.diags_array(self._sliding)
            mixed = mixed + self._tangents.T @ friction.T
            outer = outer + friction @ self._slip + (friction @ self._slip).T
        if rotated.basis is not None:
            mixed = rotated.basis.T @ mixed
        held, follows = self._respond.held, self._respond.held_by(self._gap, slip)
        inside, _ = rotated.factor(active)
        stiffness = sp.csr_array(rotated.K)
        coupled = follows.T @ mixed[held]
        outer = outer - coupled - coupled.T + follows.T @ stiffness[held][:, held] @ follows
        mixed = mixed[inside] - stiffness[inside][:, held] @ follows
        corner = rotated.K[:, inside][inside]
        return Lifted(sp.csc_array(outer), sp.csc_array(mixed), corner, inside, rotated.F.size)

    def __call__(self, d: Array) -> Array:
        """``L'' d`` for a vector (n,), or for each column of a matrix (n, k)."""
        if d.ndim == 2 or d.size > DENSE:
            return self._products(d)
        if self._whole is None:
            self._whole = self._products(np.eye(d.size))
        return self._whole @ d

    def _products(self, d: Array) -> Array:
        sliding = self._sliding if d.ndim == 1 else self._sliding[:, None]
        out_of_balance, slip = self._uq @ d, np.zeros((self._active.touching.size, *d.shape[1:]))
        if sliding.size:
            bound = sliding * (self._sq @ d)  # change of the friction of sliding nodes
            out_of_balance = out_of_balance + self._tangents.T @ bound
            slip[self._rows] = self._slip @ d
        u, normal, tangential = self._respond(out_of_balance, self._gap @ d, slip)
        result = self.qq @ d + self._qu @ u - self._gap.T @ normal
        if sliding.size:
            result += self._qs @ (sliding * (self._tangents @ u + slip[self._rows]))
            result += self._slip.T @ (bound - tangential[self._rows])
        return result


def curvature_of(function: Reduced) -> Callable[[ReducedPoint], Hessian | ObjectiveHessian]:
    """Second derivatives of an outer objective at a point, ready for products."""
    if isinstance(function, ReducedEnergy):
        return Curvature(function).at
    return lambda point: function.conditions.at(point).hessian(function.conditions.program.value)
