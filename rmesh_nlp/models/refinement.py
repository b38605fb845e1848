"""Local refinement, to compare relocation with and to combine it with.

The gain of energy by a new node on each edge says where to refine, for any law, load and contact
(:func:`edge_gains`). Triangles are marked by their share of the sum (W. Dörfler, SIAM J. Numer. Anal. 33
(1996) 1106-1124) and cut by longest edges (red, green and blue), names are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.energy_flips import ElementEnergies
from rmesh_nlp.problem import ContactProblem

SHARE = 0.5
"""Dörfler's parameter: part of the sum of the indicators that the marked triangles must have."""


def marked(indicators: Array, share: float = SHARE) -> NDArray[np.int64]:
    """The fewest triangles whose indicators, errors squared, are ``share`` of the sum."""
    order = np.argsort(-indicators, kind="stable")
    total = np.cumsum(indicators[order])
    return order[: 1 + int(np.searchsorted(total, share * total[-1]))] if total[-1] > 0 else order[:0]


def edge_gains(problem: ContactProblem) -> Array:
    """(elements,) decrease of the energy by a new node in the middle of each edge, the others held.

    An edge's gain is shared by its triangles. It is an error estimator of hierarchical kind: the energy is
    minimised over each new value by itself, contact not regarded.
    """
    mesh, triangles = problem.mesh, problem.triangles
    n, facets = mesh.p.shape[1], np.asarray(mesh.facets)
    model = ContactSolver(problem)
    values = model.displacement.values(model.solve(mesh.p).u)
    held = problem.held()[0]
    both = held[:, facets[0]] & held[:, facets[1]]
    # a facet of the outer boundary between two held nodes may be held; inside none is
    outer = np.zeros(facets.shape[1], dtype=bool)
    outer[mesh.boundary_facets()] = True
    free = ~(both & outer)
    nodes = np.hstack([mesh.p, mesh.p[:, facets].mean(axis=1)])
    field = np.hstack([values, values[:, facets].mean(axis=1)])
    energies = ElementEnergies(problem, nodes, field)
    gain = np.zeros(facets.shape[1])
    scale = float(np.max(np.abs(values), initial=0.0)) or 1.0
    facet_of = _facet_numbers(facets, triangles, n)
    elements = np.tile(np.arange(triangles.shape[1]), 3)
    for i in range(problem.components):
        slope, curvature = np.zeros((2, facets.shape[1]))
        plus, here, minus = (
            _halves(energies.at(_shifted(field, i, n, step)), triangles, facet_of, n, elements)
            for step in (scale, 0.0, -scale)
        )
        # the energy is quadratic in each value
        np.add.at(slope, facet_of.ravel(), (plus - minus) / (2 * scale))
        np.add.at(curvature, facet_of.ravel(), (plus - 2 * here + minus) / scale**2)
        part = np.where(curvature > 0, slope**2 / (2 * np.maximum(curvature, 1e-300)), 0.0)
        gain += np.where(free[i], part, 0.0)
    sides = np.bincount(facet_of.ravel(), minlength=facets.shape[1])
    return np.asarray((gain / np.maximum(sides, 1))[facet_of].sum(axis=0))


def _shifted(field: Array, component: int, first: int, step: float) -> Array:
    """A field with one component of the nodes from ``first`` on moved by ``step``."""
    moved = field.copy()
    moved[component, first:] += step
    return moved


def _facet_numbers(facets: NDArray, triangles: NDArray, n: int) -> NDArray[np.int64]:
    """(3, elements) numbers of the facets of each triangle, edge i from vertex i to the next."""
    key = np.sort(facets, axis=0)
    key = key[0].astype(np.int64) * n + key[1]
    order = np.argsort(key)
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=0)]), axis=0).astype(np.int64)
    return order[np.searchsorted(key[order], ends[0] * n + ends[1])]


def _halves(
    energies: ElementEnergies, triangles: NDArray, facet_of: NDArray, n: int, elements: NDArray
) -> Array:
    """Energy of each triangle cut in two at the middle of each of its edges, edge by edge."""
    a, b, c = triangles, np.roll(triangles, -1, axis=0), np.roll(triangles, -2, axis=0)
    middle = n + facet_of
    one = np.stack([a.ravel(), middle.ravel(), c.ravel()])
    two = np.stack([middle.ravel(), b.ravel(), c.ravel()])
    return energies(one, elements) + energies(two, elements)
