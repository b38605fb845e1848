"""Multipliers of the motion's constraints: what keeps the mesh from going on.

A large multiplier of a box says that a node would go further if it were let; one of an
element's area or angle says that the connectivity of the mesh, not position, is the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT, STRAIGHT
from rmesh_nlp.mapping import Mobility
from rmesh_nlp.models.energy_program import Relocation
from rmesh_nlp.models.reduced import ReducedEnergy
from rmesh_nlp.optimize.activity import is_inside


@dataclass(frozen=True)
class Multipliers:
    """Rates at which the outer objective would fall if a bound were loosened. All are >= 0.

    Attributes
    ----------
    box : (nodes,) array
        Per unit of length by which the node's box grows in all directions; zero off its faces.
    area : (elements,) array
        Per unit of the element's least relative area.
    angle : (elements,) array
        Sum over the vertices, per unit of the scaled angle rows; zero without a least angle.
    """

    box: Array
    area: Array
    angle: Array


def multipliers(energy: ReducedEnergy, q: Array, gradient: Array) -> Multipliers:
    """Fit the multipliers at moves ``q`` to the gradient of the outer objective there.

    Those of the elements are the ones of the first-order residual, non-negative least squares over the moves
    that no box stops; what then remains at the boxes is theirs.
    """
    relocation = energy.relocation
    bound, validity = relocation.mesh_map.bound, relocation.validity
    inside, rest, values = is_inside(q, -bound, bound), gradient, np.zeros(validity.size)
    if validity.size:  # a barrier may stand in the place of the rows
        rows = energy.validity.at(q)
        values = rows.fitted(gradient, inside)
        rest = gradient - rows.jacobian.T @ values
    by_element = values.reshape(-1, validity.rows_per_element)
    area, angle = np.zeros((2, relocation.problem.mesh.t.shape[1]))
    area[validity.elements] = by_element[:, 0]
    angle[validity.elements] = by_element[:, 1:].sum(axis=1)
    return Multipliers(_by_node(relocation, q, rest, ~inside), area, angle)


def _by_node(relocation: Relocation, q: Array, rest: Array, stopped: NDArray[np.bool_]) -> Array:
    """What the boxes hold back, as energy per length, at the nodes that own the moves."""
    pull = np.where(stopped, np.maximum(-rest * np.sign(q), 0.0), 0.0)
    free = relocation.mesh_map
    index, scale = free.positions.index, free.positions.slopes(q)
    moving = (index != CONSTANT) & (free.mobility != Mobility.TIED)
    rate = np.zeros(index.shape)
    with np.errstate(divide="ignore", invalid="ignore"):  # a curve may run along an axis; see below
        rate[moving] = pull[index[moving]] / np.abs(scale[moving])
    # one move behind both coordinates: the box along the longer step is the one that stops it
    slanted = np.all(moving, axis=0) & (index[0] == index[1])
    if free.positions.bends is not None:  # along a curve the box is measured as its length
        bent = free.positions.bends.which[0] != STRAIGHT
        length = np.linalg.norm(scale, axis=0)
        rate[:, bent] = pull[index[0, bent]] / length[bent]
    return np.asarray(np.where(slanted, rate.min(axis=0), rate.sum(axis=0)))
