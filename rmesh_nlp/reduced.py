"""The reduced energy L(q) = min_u J(u; X(q)) with its gradient: the outer function of ``nested``."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import nnls

from rmesh_nlp.equilibrium import ActiveSet, ContactModel, Equilibrium
from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.relocation import Relocation

ACTIVE_AREA = 1e-6
"""Scaled distance to its bound below which an element-area constraint counts as active."""


@dataclass(frozen=True)
class ReducedPoint:
    """L, its gradient with respect to the moves q, and the contact solution behind them."""

    q: Array
    energy: float
    gradient: Array
    equilibrium: Equilibrium


class ReducedEnergy:
    """Evaluates L(q) by one contact solve, warm-started from the last active set.

    The gradient is (5.7), (5.11): the partial derivative of the Lagrangian of the inner
    problem with respect to the positions, at fixed displacement and multipliers. It includes
    the motion of the gap and of the friction weights.

    Attributes
    ----------
    contact_solves : int
        Number of contact solves so far.
    """

    def __init__(self, relocation: Relocation, model: ContactModel | None = None) -> None:
        self.relocation = relocation
        self.model = model or ContactModel(relocation.problem)
        self.contact_solves = 0
        self._active: ActiveSet | None = None
        self._last: ReducedPoint | None = None
        nlp = relocation.nlp
        lam = ca.MX.sym("lam", relocation.n_contact)
        gap_jacobian = relocation.derivatives.jac_g(nlp.x, nlp.p)[1][relocation.gap_rows, : relocation.n_q]
        energy_gradient = relocation.derivatives.grad_f(nlp.x, nlp.p)[1][: relocation.n_q]
        gradient = energy_gradient - gap_jacobian.T @ lam
        self._gradient = Evaluator(ca.Function("reduced_gradient", [nlp.x, lam], [ca.densify(gradient)]))
        validity = relocation.validity_rows
        rows = relocation.derivatives.jac_g(nlp.x, nlp.p)
        self._areas = ca.Function("areas", [nlp.x], [rows[0][validity], rows[1][validity, : relocation.n_q]])

    def __call__(self, q: Array) -> ReducedPoint:
        """Evaluate at moves ``q``; the last point is remembered."""
        if self._last is not None and np.array_equal(self._last.q, q):
            return self._last
        nodes = self.relocation.nodes(q)
        equilibrium = self.model.solve(nodes, self._active)
        self.contact_solves += 1
        self._active = equilibrium.active
        x = self.point(q, equilibrium)
        (gradient,) = self._gradient(x, equilibrium.normal_force)
        self._last = ReducedPoint(np.array(q), equilibrium.energy, gradient, equilibrium)
        return self._last

    def point(self, q: Array, equilibrium: Equilibrium) -> Array:
        """The unknowns ``(q, u, s)`` of the energy program at a contact solution."""
        slip = np.abs(self.model.tangents @ equilibrium.u) if self.relocation.n_s else np.zeros(0)
        return np.concatenate([q, equilibrium.u, slip])

    def stationarity_residual(self, point: ReducedPoint) -> float:
        """How far q is from a first-order point of L over the admissible set, relative to the energy.

        The natural residual ``max |q - clip(q - r / scale, -1, 1)|``, r the gradient less the
        pull of active element areas, whose non-negative multipliers are fitted by least
        squares. The moves are in units of their boxes, so r has the unit of an energy.
        """
        scale = max(abs(point.energy), 1e-300)
        r = point.gradient
        if self.relocation.n_valid:
            area, jacobian = self._areas(self.point(point.q, point.equilibrium))
            bound = self.relocation.nlp.lbg[self.relocation.validity_rows]
            active = np.flatnonzero(area.full().ravel() - bound < ACTIVE_AREA)
            if active.size:
                inside = np.abs(point.q) < 1 - 1e-6
                rows = jacobian.full()[active]
                multipliers = nnls(rows[:, inside].T, r[inside])[0]
                r = r - rows.T @ multipliers
        return float(np.max(np.abs(point.q - np.clip(point.q - r / scale, -1, 1)), initial=0.0))
