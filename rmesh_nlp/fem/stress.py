"""Stresses of a displacement, element by element."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.fem.bernstein import functions, slopes
from rmesh_nlp.fem.sampling import pieces
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem import ContactProblem, Law
from rmesh_nlp.problem.body import gradients as of_shares
from rmesh_nlp.problem.quadrature import triangle_rule

CENTRE = np.full(3, 1 / 3)


def gradients(problem: ContactProblem, X: Array, displacement: Array, shares: Array = CENTRE) -> Array:
    """Displacement gradient (components, 2, elements, ...) at barycentric coordinates (3, ...)."""
    space = DisplacementSpace(problem)
    # the linear fields that have the slopes of positions and displacement there
    x, u = _local(space, (space.points_on_body(X), displacement), slopes(space.order, shares))
    with np.errstate(divide="ignore", invalid="ignore"):  # an invalid mesh is written too
        return np.einsum("cv...,jv...->cj...", u, of_shares(x))


def _local(space: DisplacementSpace, fields: Sequence[Array], values: Array) -> list[Array]:
    """(components, ..., elements, ...) of fields (components, nodes), by values (functions, ...)."""
    of_elements = (space.coefficients(field)[:, space.elements] for field in fields)
    return [np.einsum("cne,nv...->cve...", field, values) for field in of_elements]


def stresses(problem: ContactProblem, X: Array, displacement: Array, shares: Array = CENTRE) -> Array:
    """Stress in N/m^2 in each element, at its centre or at other barycentric coordinates (3, ...).

    Vertices are at X (2, vertices), the displacement (components, nodes) is given at the nodes' points. On a
    straight triangle the stress of a linear displacement is constant, of a quadratic one it is linear, and at
    the centre its mean.

    Returns
    -------
    (4, elements, ...) array of sigma_xx, sigma_yy, sigma_xy, sigma_zz; for a scalar problem the
    (2, elements, ...) flux, conductivity times grad u.
    """
    result = np.zeros((2 if problem.components == 1 else 4, problem.mesh.nelements, *shares.shape[1:]))
    for law, own, fields, _ in _extended(problem, X, displacement, shares):
        result[:, own] = law.written(fields)
    return result


def strain_energies(problem: ContactProblem, X: Array, displacement: Array) -> Array:
    """(elements,) strain energies of a displacement as in :func:`stresses`, on straight triangles."""
    (shares, weights), areas = triangle_rule(4), signed_areas(X, problem.triangles)
    result = np.zeros(areas.size)
    for law, own, fields, x in _extended(problem, X, displacement, shares):
        density = law.energy_product(fields) / 2 * problem.measured(x)
        result[own] = areas[own] * (density @ weights)
    return result


def _extended(
    problem: ContactProblem, X: Array, displacement: Array, shares: Array
) -> Iterator[tuple[Law, Index, Array, Array]]:
    """Of each region its law, its elements, and at barycentric coordinates what stresses depend on, and x."""
    gradient, space = gradients(problem, X, displacement, shares), DisplacementSpace(problem)
    values = functions(space.order, shares)[:, None]
    x, u = _local(space, (space.points_on_body(X), displacement), values)
    for law, own in problem.regions:
        yield law, own, law.extended(gradient[:, :, own], u[:, 0, own], x[:, 0, own]), x[:, 0, own]


def von_mises(stress: Array) -> Array:
    """Equivalent stress (elements, ...) of stresses (4, elements, ...)."""
    xx, yy, xy, zz = stress
    return np.sqrt(((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * xy**2)


def size_of_stress(problem: ContactProblem, X: Array, displacement: Array) -> Array:
    """(elements, pieces) von Mises stress, or the length of the flux of a scalar problem, as it is drawn."""
    stress = stresses(problem, X, displacement, pieces(DisplacementSpace(problem).elements).centres)
    return np.linalg.norm(stress, axis=0) if problem.components == 1 else von_mises(stress)
