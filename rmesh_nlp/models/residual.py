"""The first-order conditions of the outer problem: their residual, and the multipliers of the bounds.

At q with gradient g of the objective let w >= 0 be multipliers of the validity rows and constraints
c(q) >= 0,
fitted by least squares, and r = g - c'(q)^T w. The residual is

    max ( max_i |q_i - clip(q_i - r_i / unit)|,   max_k |min(c_k, w_k / unit)| ),

the natural residual of the KKT conditions over move limits and elements, ``unit`` being the largest component
of r on the mesh as given. So it is 1 on the given mesh, on coarse and on fine grids alike, and at a point
with residual 1e-6 no released outer variable can change the objective at more than a millionth of the initial
rate. Relative to the objective itself the gradient falls about twentyfold with each halving of the mesh size.

A large multiplier of a move limit says that a node would go further if it could; one of an element's area or
angle says that the connectivity of the mesh, not position, is the limit. Histories, stopping tests and
records use this file, and nothing else measures stationarity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.evaluation import Array, Mask, is_finite, magnitude
from rmesh_nlp.fem.fields import NONE
from rmesh_nlp.mapping import MeshMap, Mobility
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.reduced_constraints import ReducedConstraints
from rmesh_nlp.models.reduced_model import ReducedEnergy, ReducedPoint
from rmesh_nlp.optimize.activity import ZERO, is_inside
from rmesh_nlp.optimize.constraints import stacked


class OuterResidual:
    """The first-order residual of one objective.

    The energy is that of the problem, for its move limits and elements; ``given`` is the objective on the
    mesh as given, and ``unit`` what gradients are measured in: at least ``ZERO`` in units of the objective.
    Below it the gradient on the given mesh is small already, and a millionth of it would be rounding (near
    1e-13 on the examples with up to 128 squares a side).
    """

    def __init__(
        self, energy: ReducedEnergy, given: ReducedPoint, constraints: ReducedConstraints | None = None
    ) -> None:
        self._energy, self._constraints = energy, constraints
        largest = magnitude(released(energy, given.q, given.gradient).rest)
        self.unit = max(largest, ZERO * size_of(given)) or 1.0

    def __call__(self, point: ReducedPoint) -> float:
        """The residual at a point of the objective; infinite if its gradient is not finite."""
        return self.at(point.q, point.gradient)

    def of_state(self, q: Array, u: Array, normal_force: Array, friction: Array) -> float:
        """The residual of the energy at q with a solver's own displacements and forces.

        It costs no contact solve, and is that of :meth:`__call__` where equilibrium and contact law hold.
        """
        q = self._energy.relocation.parts.mesh_map.clipped(q)  # an interior point may leave them by rounding
        return self.at(q, self._energy.lagrangian(self._energy.unknowns(q, u), normal_force, friction)[1])

    def at(self, q: Array, gradient: Array) -> float:
        """The residual at ``q`` with a gradient; infinite if that is not finite."""
        return released(self._energy, q, gradient, self._constraints).residual(self.unit)


@dataclass(frozen=True)
class Released:
    """The gradient at ``q`` less the pull of the constraints, ``rest``, and their slacks and multipliers.

    Elements, whose slack is at least zero, come first; a slack of other constraints may be negative.
    """

    relocation: Relocation
    q: Array
    rest: Array
    slack: Array
    fitted: Array

    def residual(self, unit: float) -> float:
        """The residual in a unit of gradients; infinite if the gradient is not finite."""
        if not is_finite(self.rest):
            return float("inf")
        natural = np.abs(self.q - self.relocation.parts.mesh_map.clipped(self.q - self.rest / unit))
        pairs = np.abs(np.minimum(self.slack, self.fitted / unit))
        return float(max(np.max(natural, initial=0.0), np.max(pairs, initial=0.0)))

    @property
    def multipliers(self) -> OuterMultipliers:
        """Of the elements those that were fitted; what then remains at the move limits is theirs."""
        validity, free = self.relocation.validity, self.relocation.parts.mesh_map
        by_element = self.fitted[: validity.size].reshape(validity.group.rows.T.shape)
        area, angle = np.zeros((2, self.relocation.parts.problem.mesh.nelements))
        area[validity.elements] = by_element[:, 0]
        angle[validity.elements] = by_element[:, 1:].sum(axis=1)
        stopped = ~is_inside(self.q, free.lower, free.upper)
        return OuterMultipliers(_by_node(free, self.q, self.rest, stopped), area, angle)


def released(
    energy: ReducedEnergy, q: Array, gradient: Array, constraints: ReducedConstraints | None = None
) -> Released:
    """The gradient of the outer objective at ``q`` less the pull of elements and constraints.

    Their multipliers are non-negative least squares over the outer variables inside their limits.
    """
    relocation, rows = energy.relocation, []
    if relocation.n_valid:  # a barrier may stand in the place of the rows
        areas = relocation.validity.at(q)
        rows.append(replace(areas, slack=np.maximum(areas.slack, 0.0)))
    if constraints is not None:
        rows.append(constraints.linearised(energy(q)))
    if not rows:
        return Released(relocation, q, gradient, np.zeros(0), np.zeros(0))
    free, every = relocation.parts.mesh_map, stacked(rows)
    fitted = np.zeros(every.slack.size)
    if is_finite(gradient):
        fitted = every.fitted(gradient, is_inside(q, free.lower, free.upper))
    return Released(relocation, q, gradient - every.jacobian.T @ fitted, every.slack, fitted)


def size_of(point: ReducedPoint) -> float:
    """Size of an objective; parts of an energy may cancel in their sum, the strain energy does not."""
    u = point.equilibrium.u
    strain = 0.5 * float(u @ (point.system.stiffness @ u)) if point.is_energy else 0.0
    return max(abs(point.value), strain)


@dataclass(frozen=True)
class OuterMultipliers:
    """Rates at which the outer objective would fall if a bound were loosened. All are >= 0.

    ``limit`` (nodes,) is per unit of length by which the node's move limits grow in all directions, ``area``
    (elements,) per unit of the element's least relative area, ``angle`` (elements,) the sum over the vertices
    per unit of the scaled angle rows.
    """

    limit: Array
    area: Array
    angle: Array


def _by_node(free: MeshMap, q: Array, rest: Array, stopped: Mask) -> Array:
    """Multipliers of move limits, as energy per length, at the nodes that own the outer variables."""
    pull = np.where(stopped, np.maximum(-rest * np.sign(q), 0.0), 0.0)
    index, scale = free.positions.index, free.positions.slopes(q)
    moving = (index != NONE) & (free.mobility != Mobility.TIED)
    rate = np.zeros(index.shape)
    with np.errstate(divide="ignore", invalid="ignore"):  # a curve may run along an axis; see below
        rate[moving] = pull[index[moving]] / np.abs(scale[moving])
    # one variable behind both coordinates: the limit along the longer step is the active one
    slanted = np.all(moving, axis=0) & (index[0] == index[1])
    if free.positions.bends is not None:  # along a curve the limit is measured as its length
        bent = free.positions.bends.which[0] != NONE
        length = np.linalg.norm(scale, axis=0)
        rate[:, bent] = pull[index[0, bent]] / length[bent]
    return np.where(slanted, rate.min(axis=0), rate.sum(axis=0))
