"""Second derivatives of the reduced model, as products with a vector.

Of the reduced energy L(q): with Lambda the Lagrangian of the energy NLP in ``x = (q, u, s)``, and ``S d`` the
change of x with q along contact solutions, their active set held,

    L'' = S^T Lambda_xx S,    S = S_0 - S_1 K^-1 S_1^T Lambda_xx S_0,

K the stiffness over the displacements that contact leaves free, which the contact solve has factorised, S_1
the change of x with these displacements, and S_0 that with q while they stay. Second derivatives of any other
objective are of :mod:`rmesh_nlp.models.kkt_point`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Block, Symmetric
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.kkt_model import ContactPoint

DENSE = 200
"""Outer variables up to which all products are formed at once: one solve with as many right sides costs less
than the products of a step one by one (7 against 25 on Example 6.1 with 126 of them; as much with 286)."""


class Hessian:
    """F'' at one point.

    ``partial`` (n, n) is the second derivative of the Lagrangian at fixed displacement and forces;
    ``products`` multiplies a vector (n,), or each column of a matrix (n, k), by F''. Of the variables the
    first ``n_positions`` are of node positions, the others of a design.
    """

    def __init__(self, partial: sp.csr_array, n_positions: int, products: Callable[[Array], Array]) -> None:
        self._partial, self._n_positions, self._products = partial, n_positions, products

    def diagonal(self) -> Array:
        """Size of the diagonal of ``partial``, of F'' for design variables, kept away from zero.

        The Lagrangian may be linear in a modulus or a load.
        """
        diagonal, designs = self._partial.diagonal(), np.arange(self._n_positions, self._partial.shape[0])
        if designs.size:
            units = np.eye(diagonal.size)[:, designs]
            diagonal[designs] = self(units)[designs, np.arange(designs.size)]
        diagonal = np.abs(diagonal)
        return np.maximum(diagonal, 1e-3 * np.max(diagonal, initial=1e-300))

    def __call__(self, d: Array) -> Array:
        """``F'' d`` for a vector (n,), or for each column of a matrix (n, k)."""
        return self._whole @ d if d.ndim == 1 and d.size <= DENSE else self._products(d)

    @cached_property
    def _whole(self) -> Array:
        return self._products(np.eye(self._partial.shape[0]))


class Lifted(Hessian):
    """L'' as a Schur complement, ``outer - mixed^T stiffness^-1 mixed``, all three of them sparse.

    ``free`` has the displacements that contact leaves free, and solutions with their ``stiffness``.
    """

    def __init__(
        self,
        partial: sp.csr_array,
        n_positions: int,
        outer: sp.csr_array,
        mixed: sp.csr_array,
        point: ContactPoint,
    ) -> None:
        super().__init__(partial, n_positions, self.products)
        self.outer, self.mixed, rotated = outer, mixed, point.system.rotated
        self.free = rotated.factor(point.equilibrium.active)
        self.stiffness = rotated.K[:, self.free.inside][self.free.inside]

    def products(self, d: Array) -> Array:
        """``L'' d``."""
        return self.outer @ d - self.mixed.T @ self.free.solve(self.mixed @ d)


class Curvature:
    """Evaluates L'' at contact solutions of one problem; where blocks are in the whole is found once."""

    def __init__(self, relocation: Relocation) -> None:
        self._relocation, first = relocation, relocation.assembled.first.pattern
        upper, (q, u, s) = relocation.assembled.second.pattern, relocation.unknowns.places.values()
        self._second = Symmetric(upper, relocation.parts.n_q), Block(upper, q, u), Block(upper, q, s)
        self._first = tuple(Block(first, relocation.rows[name], q) for name in ("gaps", "plus"))

    def at(self, x: Array, point: ContactPoint) -> Lifted:
        """L'' at a contact solution, whose unknowns are ``x``.

        Of Lambda_xx the stiffness is known, and s has no second derivatives but with q.
        """
        rel, system, solved = self._relocation, point.system, point.equilibrium
        rows, rotated, active = rel.parts.friction_rows, system.rotated, solved.active
        forces = rel.multipliers(solved.normal_force, solved.tangential_force[rows])
        (second,) = rel.assembled.second(x, None, np.ones(1), -forces)
        *_, first = rel.assembled.first(x, None)
        qq, uq, sq = (block(second).T for block in self._second)  # by rows
        gaps, slips = (sp.csr_array(block(first)) for block in self._first)
        sticks, tangents = rotated.sticking(active)[rows], system.tangents[rows]
        held = np.append(rotated.normal[active.touching], rotated.tangent[rows[sticks]])
        follows = sp.vstack([gaps[active.touching], slips[sticks]])
        u, free = -(rotated.basis[:, held] @ follows), rotated.basis[:, rotated.factor(active).inside]
        sliding = sp.diags_array(active.sliding[rows] * 1.0)
        force, half = system.stiffness @ u, u.T @ uq + (sliding @ (tangents @ u + slips)).T @ sq
        outer = qq + half + half.T + u.T @ force
        mixed = free.T @ (uq + force + tangents.T @ (sliding @ sq))
        return Lifted(qq, rel.parts.mesh_map.n_positions, outer, mixed, point)
