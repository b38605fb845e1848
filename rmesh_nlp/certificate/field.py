"""A flux or stress in equilibrium, with everything the bound needs to know of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.certificate.equilibration import Balance
from rmesh_nlp.certificate.integrals import Integrals, over_triangles
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem


@dataclass(frozen=True)
class Guess:
    """What the computed solution knows: where the equilibration begins.

    Attributes
    ----------
    displacement : (components, nodes) array
    pressure, friction : (nodes,) arrays
        Contact pressure and friction at the nodes.
    """

    displacement: Array
    pressure: Array
    friction: Array


@dataclass(frozen=True)
class EquilibratedField:
    """A flux or stress in equilibrium, element by element.

    Attributes
    ----------
    values : (2 or 3, elements) array
        Mean flux, or mean stress xx, yy, xy.
    energy : (elements,) array
        Complementary energy, half the square of the energy norm of the field.
    defect : (elements,) array
        Distance in the energy norm from the flux or stress of the computed displacement.
    variation : (elements,) array
        Distance in the energy norm from the nearest field that is constant on the element.
    forces : (elements, local traces) array
        Tractions at the ends of the edges of each element times the length of the edge.
    balance : Balance
    residual : float
        Largest violation of equilibrium inside elements, relative to the largest force.
    load_remainder : (elements,) array
        L2 norm of the load less what the field balances, its best linear approximation.
    load_doubt : float
        What quadrature of the load may have changed in the energy.
    gradient_by_energy : (elements,) array
        See :func:`rmesh_nlp.certificate.oscillation.oscillation`.
    obstacle_work, obstacle_gap : (elements,) arrays
        Work of the reaction of an obstacle in the interior, on the obstacle and on the gap.
    obstacle_doubt : float
    """

    values: Array
    energy: Array
    defect: Array
    variation: Array
    forces: Array
    balance: Balance
    residual: float
    load_remainder: Array
    load_doubt: float
    gradient_by_energy: Array
    obstacle_work: Array
    obstacle_gap: Array
    obstacle_doubt: float = 0.0


@dataclass(frozen=True)
class Loads:
    """Sources or body forces, component by component, and their sums over elements.

    Attributes
    ----------
    moments, doubt : (components, 3, elements) arrays
        As in :class:`rmesh_nlp.certificate.integrals.Integrals`.
    square : (elements,) array
        Mean of |f|^2.
    constant : (elements,) bool array
    """

    moments: Array
    doubt: Array
    square: Array
    constant: Array


def loads(problem: ContactProblem, skeleton: Skeleton) -> Loads:
    """Moments of the load of a problem on each element."""
    n, count = problem.components, skeleton.triangles.shape[1]
    moments, doubt = np.zeros((2, n, 3, count))
    square, constant = np.zeros(count), np.ones(count, dtype=bool)
    corners = skeleton.nodes[:, skeleton.triangles]
    for law, elements in problem.regions:
        for i, coefficient in enumerate(law.load):
            part: Integrals = over_triangles(coefficient, corners[:, :, elements])
            moments[i][:, elements], doubt[i][:, elements] = part.moments, part.doubt
            square[elements] += part.square
            if callable(coefficient):
                constant[elements] = False
    return Loads(moments, doubt, square, constant)


def work(moments: Array, displacement: Array, skeleton: Skeleton) -> Array:
    """(elements,) integrals of f . u for a displacement (components, nodes)."""
    local = displacement[:, skeleton.triangles]
    return np.asarray(np.einsum("cie,cie,e->e", moments, local, skeleton.areas))


def doubtful_work(doubt: Array, displacement: Array, skeleton: Skeleton) -> float:
    """How much the energy may be wrong by the doubt of the moments of the load."""
    if not np.any(doubt):
        return 0.0
    largest = float(np.max(np.abs(displacement)))
    local = np.abs(displacement[:, skeleton.triangles]) + largest
    return float(np.einsum("cie,cie,e->", doubt, local, skeleton.areas))


def gradients(displacement: Array, skeleton: Skeleton) -> Array:
    """(components, 2, elements) gradients of a piecewise linear displacement."""
    local = displacement[:, skeleton.triangles]
    return np.asarray(-np.einsum("cie,die->cde", local, skeleton.normals) / (2 * skeleton.areas))


def end_values(nodal: Array, skeleton: Skeleton, edges: NDArray[np.int64]) -> Array:
    """(2, edges) values of a nodal field at the ends of some edges."""
    return np.asarray(nodal[skeleton.ends[:, edges]])
