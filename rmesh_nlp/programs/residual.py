"""The first-order residual of the outer problem: one measure for histories, stopping tests and records.

At moves q with gradient g of the objective let w >= 0 be multipliers of the validity rows c(q) >= 0, fitted
by least squares, and r = g - c'(q)^T w. The residual is

    max ( max_i |q_i - clip(q_i - r_i / unit)|,   max_k min(c_k, w_k / unit) ),

the natural residual of the KKT conditions over boxes and elements, ``unit`` being the largest component of r
on the mesh as given. So it is 1 on the given mesh, on coarse and on fine grids alike, and at a point with
residual 1e-6 no released move can change the objective at more than a millionth of the initial rate. Relative
to the objective itself the gradient falls about twentyfold with each halving of the mesh size.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.smooth_constraints import is_inside
from rmesh_nlp.programs.reduced import ReducedEnergy, ReducedPoint

FLOOR = 1e-6
"""Least unit, in units of the objective: below it the gradient on the given mesh is small already, and
a millionth of it would be rounding (near 1e-13 on the examples with up to 128 squares a side)."""


class OuterResidual:
    """The first-order residual of one objective.

    Parameters
    ----------
    energy : ReducedEnergy
        Of the problem, for its boxes and elements.
    given : ReducedPoint
        The objective on the mesh as given.

    Attributes
    ----------
    unit : float
        What the gradient is measured in.
    """

    def __init__(self, energy: ReducedEnergy, given: ReducedPoint) -> None:
        self._energy = energy
        released, _ = self._released(given)
        largest = float(np.max(np.abs(released), initial=0.0))
        self.unit = max(largest, FLOOR * size_of(given)) or 1.0

    def __call__(self, point: ReducedPoint) -> float:
        """The residual at a point of the objective; infinite if its gradient is not finite."""
        if not np.all(np.isfinite(point.gradient)):
            return float("inf")
        box = self._energy.relocation.freedoms.bound
        released, law = self._released(point)
        natural = np.abs(point.q - np.clip(point.q - released / self.unit, -box, box))
        pairs = 0.0 if law is None else np.max(np.minimum(law[0], law[1] / self.unit), initial=0.0)
        return float(max(np.max(natural, initial=0.0), pairs))

    def _released(self, point: ReducedPoint) -> tuple[Array, tuple[Array, Array] | None]:
        """The gradient less the pull of elements; slacks of the elements and their multipliers."""
        if not self._energy.relocation.n_valid:
            return point.gradient, None
        box = self._energy.relocation.freedoms.bound
        rows = self._energy.validity.at(point.q)
        multipliers = rows.fitted(point.gradient, is_inside(point.q, -box, box))
        return point.gradient - rows.jacobian.T @ multipliers, (np.maximum(rows.slack, 0.0), multipliers)


def size_of(point: ReducedPoint) -> float:
    """Size of an objective; parts of an energy may cancel in their sum, the strain energy does not."""
    u = point.equilibrium.u
    strain = 0.5 * float(u @ (point.system.stiffness @ u)) if point.is_energy else 0.0
    return max(abs(point.value), strain)
