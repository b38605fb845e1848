"""Multipliers of the motion's constraints: what keeps the mesh from going on.

A large multiplier of a box says that a node would go further if it were let; one of an
element's area or angle says that the connectivity of the mesh, not position, is the limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import CONSTANT
from rmesh_nlp.programs.energy_program import Relocation
from rmesh_nlp.programs.freedoms import Mobility, constrained_elements

ACTIVE = 1e-4
"""Distance to its bound, in scaled units, within which a constraint may hold a multiplier."""

LARGEST_DENSE = 2_000_000
"""Entries of a least-squares matrix that is solved densely."""


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


def multipliers(relocation: Relocation, q: Array, gradient: Array) -> Multipliers:
    """Fit the multipliers at moves ``q`` to the gradient of the outer objective there.

    Those of active areas and angles are fitted, non-negative, by least squares to the gradient
    on the moves that no box stops; what then remains at the boxes is theirs.
    """
    free, problem = relocation.freedoms, relocation.problem
    stopped = np.abs(q) >= free.bound * (1 - ACTIVE)
    rows = _validity_rows(relocation, q)
    # a barrier may stand in the place of the rows
    elements = constrained_elements(problem, free) if relocation.n_valid else np.zeros(0, np.int64)
    per_element = relocation.n_valid // elements.size if elements.size else 1
    values = np.zeros(relocation.n_valid)
    rest = gradient
    if relocation.n_valid:
        value, jacobian = rows
        bound = relocation.nlp.lbg[relocation.validity_rows]
        active = np.flatnonzero(value - bound < ACTIVE)
        if active.size:
            matrix = jacobian[active][:, ~stopped].T
            values[active] = _nonnegative_fit(matrix, gradient[~stopped])
            rest = gradient - jacobian[active].T @ values[active]
    by_element = values.reshape(-1, per_element)
    area, angle = np.zeros((2, problem.mesh.t.shape[1]))
    area[elements] = by_element[:, 0]
    angle[elements] = by_element[:, 1:].sum(axis=1)
    return Multipliers(_by_node(relocation, q, rest, stopped), area, angle)


def _validity_rows(relocation: Relocation, q: Array) -> tuple[Array, Any]:
    nlp, rows = relocation.nlp, relocation.validity_rows
    value, jacobian = relocation.derivatives.jac_g(nlp.x, nlp.p)
    function = ca.Function("validity", [nlp.x], [value[rows], jacobian[rows, : relocation.n_q]])
    # rows of areas and angles depend on q alone
    value, jacobian = function(np.concatenate([q, np.zeros(nlp.n_x - q.size)]))
    return value.full().ravel(), jacobian.sparse().tocsr()


def _nonnegative_fit(matrix: Any, right: Array) -> Array:
    if matrix.shape[0] == 0:
        return np.zeros(matrix.shape[1])
    if matrix.shape[0] * matrix.shape[1] <= LARGEST_DENSE:
        return np.asarray(nnls(matrix.toarray(), right, maxiter=30 * matrix.shape[1])[0])
    return np.asarray(lsq_linear(matrix, right, bounds=(0, np.inf)).x)


def _by_node(relocation: Relocation, q: Array, rest: Array, stopped: NDArray[np.bool_]) -> Array:
    """What the boxes hold back, as energy per length, at the nodes that own the moves."""
    pull = np.where(stopped, np.maximum(-rest * np.sign(q), 0.0), 0.0)
    free = relocation.freedoms
    index, scale = free.positions.index, free.positions.scale
    moving = (index != CONSTANT) & (free.mobility != Mobility.TIED)
    rate = np.zeros(index.shape)
    rate[moving] = pull[index[moving]] / np.abs(scale[moving])
    # one move behind both coordinates: the box along the longer step is the one that stops it
    slanted = np.all(moving, axis=0) & (index[0] == index[1])
    return np.asarray(np.where(slanted, rate.min(axis=0), rate.sum(axis=0)))
