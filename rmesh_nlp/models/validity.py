"""Element validity as walls of a descent.

The rows are those of :mod:`rmesh_nlp.mapping.validity`, less their bounds: areas are
bilinear in the moves, so a step along their linearisation may invert elements. Evaluating them costs
nothing beside a contact solve, so what a step violates is taken back on the rows themselves.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.evaluation import Array, Block, Evaluator, Symmetric, numbered
from rmesh_nlp.mapping.validity import ROUNDING
from rmesh_nlp.models.energy_program import Relocation
from rmesh_nlp.optimize.polyhedron import Polyhedron
from rmesh_nlp.optimize.smooth_constraints import Wall

KEPT = 0.01
"""Part of its slack that a step leaves to an element: far away the linearisation is not to be trusted ..."""

NEAR = 1e-2
"""... unless it has no more slack than this."""

CROWDED = 20
"""Rows that are not obeyed beyond which there is no way back: a shorter step is cheaper."""

RETURNS = 10
"""Linearisations on the way back."""


class Validity:
    """The validity rows of one problem as functions of the moves q.

    Parameters
    ----------
    relocation : Relocation
    """

    def __init__(self, relocation: Relocation) -> None:
        self._validity = relocation.validity
        rows, self._bound = relocation.validity.assembled, relocation.validity.bound
        self._first, self._second = Evaluator(rows.jac_g), Evaluator(rows.hess_lag)
        self._jacobian = Block(numbered(rows.jac_g.sparsity_out(1)), slice(None), slice(None))
        self._hessian = Symmetric(numbered(rows.hess_lag.sparsity_out(0)))

    def at(self, q: Array) -> Wall:
        """The rows at valid moves ``q``."""
        slack, jacobian = self._rows(q)
        return Wall(slack, np.where(slack > NEAR, KEPT * slack, np.minimum(ROUNDING, slack)), jacobian)

    def hessian(self, q: Array, multipliers: Array) -> sp.csc_array:
        """The Hessian of ``multipliers . rows``."""
        (values,) = self._second(q, [], 0.0, multipliers)
        return self._hessian(values)

    def back(self, q: Array, wall: Wall, lower: Array, upper: Array, scale: Array) -> Array | None:
        """Moves near ``q`` that are valid, by Newton's method on the rows; None if it fails."""
        enough = np.minimum(wall.floor, 0.5 * ROUNDING)
        for _ in range(RETURNS):
            slack, jacobian = self._rows(q)
            if np.all(slack >= enough):
                return q
            if np.count_nonzero(slack < enough) > CROWDED:
                return None
            steps = Polyhedron(lower - q, upper - q, slack - wall.floor, jacobian, scale)
            q = np.clip(q + steps.project(np.zeros(q.size)), lower, upper)
        return None

    def _rows(self, q: Array) -> tuple[Array, sp.csr_array]:
        value, jacobian = self._first(q, [])
        return value - self._bound, sp.csr_array(self._jacobian(jacobian))
