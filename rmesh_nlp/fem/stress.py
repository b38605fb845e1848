"""Stresses of a P1 displacement, element by element."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.laws import Laplace


def gradients(problem: ContactProblem, nodes: Array, displacement: Array) -> Array:
    """Displacement gradient (components, 2, elements), constant on each element."""
    triangles = problem.triangles
    X, u = nodes[:, triangles], displacement[:, triangles]
    edges = np.stack([X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]], axis=1)  # (2, edge, elements)
    difference = np.stack([u[:, 1] - u[:, 0], u[:, 2] - u[:, 0]], axis=1)
    (a, b), (c, d) = edges  # x and y of the first and of the second edge
    with np.errstate(divide="ignore", invalid="ignore"):  # an invalid mesh is written too
        inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
    return np.einsum("cke,kje->cje", difference, inverse)


def stresses(problem: ContactProblem, nodes: Array, displacement: Array) -> Array:
    """Stress of each element in N/m^2.

    Returns
    -------
    (4, elements) array of sigma_xx, sigma_yy, sigma_xy, sigma_zz; for a scalar problem the
    (2, elements) flux, conductivity times grad u.
    """
    gradient = gradients(problem, nodes, displacement)
    result = np.zeros((2 if problem.components == 1 else 4, gradient.shape[-1]))
    for law, elements in problem.regions:
        part = gradient[..., elements]
        if isinstance(law, Laplace):
            result[:, elements] = law.conductivity * part[0]
            continue
        trace = part[0, 0] + part[1, 1]
        shear = law.lame_mu * (part[0, 1] + part[1, 0])
        normal = [law.in_plane_lambda * trace + 2 * law.lame_mu * part[i, i] for i in range(2)]
        result[:, elements] = [*normal, shear, law.out_of_plane_stress(trace)]
    return result


def von_mises(stress: Array) -> Array:
    """Equivalent stress (elements,) of stresses (4, elements)."""
    xx, yy, xy, zz = stress
    return np.asarray(np.sqrt(((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * xy**2))
