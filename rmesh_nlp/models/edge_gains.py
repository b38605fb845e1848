"""The gain of energy by a new node on each edge, which says where to refine, for any law, load and contact.

Triangles are marked by their share of the sum (W. Dörfler, SIAM J. Numer. Anal. 33 (1996) 1106-1124).
"""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.element import plain
from rmesh_nlp.fem.energy import load_energy, strain_energy
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.coefficients import is_nonzero
from rmesh_nlp.vectorised import columnwise

SHARE = 0.5
"""Dörfler's parameter: part of the sum of the indicators that the marked triangles must have."""


def marked(indicators: Array, share: float = SHARE) -> NDArray[np.int64]:
    """The fewest triangles whose indicators, errors squared, are ``share`` of the sum."""
    order = np.argsort(-indicators, kind="stable")
    total = np.cumsum(indicators[order])
    return order[: 1 + int(np.searchsorted(total, share * total[-1]))] if total[-1] > 0 else order[:0]


def edge_gains(problem: ContactProblem) -> Array:
    """(elements,) decrease of the energy by a new node in the middle of each edge, the others fixed.

    An edge's gain is shared by its triangles. It is an error estimator of hierarchical kind: the energy is
    minimised over each new value by itself, contact not regarded.
    """
    mesh, triangles, model = problem.mesh, problem.triangles, ContactSolver(problem)
    n, facets, n_facets = mesh.p.shape[1], mesh.facets, mesh.facets.shape[1]
    values = model.displacement.values(model.solve(mesh.p).u)
    nodes, field = (np.hstack([part, part[:, facets].mean(axis=1)]) for part in (mesh.p, values))
    # a facet of the outer boundary between two fixed nodes may be fixed; inside none is
    outer = np.isin(np.arange(n_facets), mesh.boundary_facets())
    free = ~(problem.held()[0][:, facets].all(axis=1) & outer)
    # facet i of a triangle joins vertex i and the next; two vertices of a clockwise one were exchanged
    facet_of = np.where(triangles[1] == mesh.t[1], mesh.t2f, mesh.t2f[::-1])
    a, b, c = (np.roll(triangles, -k, axis=0).ravel() for k in range(3))
    middle, elements = n + facet_of.ravel(), np.tile(np.arange(triangles.shape[1]), 3)
    halves = np.stack([a, middle, c]), np.stack([middle, b, c])
    energies = ElementEnergies(problem, nodes, field)
    scale = float(np.max(np.abs(values), initial=0.0)) or 1.0

    def energy(component: int, step: float) -> Array:
        """Of each triangle cut in two at each of its edges, whose new values are moved by a step."""
        moved = field.copy()
        moved[component, n:] += step
        return np.asarray(sum(energies.at(moved)(half, elements) for half in halves))

    gain = np.zeros(n_facets)
    for i in range(problem.components):
        plus, zero, minus = (energy(i, step) for step in (scale, 0.0, -scale))
        # the energy is quadratic in each value
        rates = (plus - minus) / (2 * scale), (plus - 2 * zero + minus) / scale**2
        slope, curvature = (np.bincount(facet_of.ravel(), rate, n_facets) for rate in rates)
        part = np.where(curvature > 0, slope**2 / (2 * np.maximum(curvature, 1e-300)), 0.0)
        gain += np.where(free[i], part, 0.0)
    sides = np.bincount(facet_of.ravel(), minlength=n_facets)
    return np.asarray((gain / np.maximum(sides, 1))[facet_of].sum(axis=0))


class ElementEnergies:
    """Energy of any triangle between nodes (2, n), displacements (components, n) frozen.

    Each triangle has the law of the element in whose place it is.
    """

    def __init__(self, problem: ContactProblem, nodes: Array, values: Array) -> None:
        self._nodes, self._values = nodes, values
        self._functions = []
        self._law = np.zeros(problem.mesh.t.shape[1], dtype=np.int64)
        for number, (law, elements) in enumerate(problem.regions):
            self._law[elements] = number
            functions = [strain_energy(law)]
            if any(is_nonzero(component) for component in law.load):
                functions.append(plain(*load_energy(law, problem.rule)))
            self._functions.append(functions)

    def at(self, values: Array) -> ElementEnergies:
        """The same with other nodal values."""
        other = copy(self)
        other._values = values
        return other

    def __call__(self, triangles: NDArray, elements: NDArray) -> Array:
        """Energies of ``triangles`` (3, n) in the places of ``elements`` (n,)."""
        result, law = np.zeros(triangles.shape[1]), self._law[elements]
        for number, functions in enumerate(self._functions):
            members = np.flatnonzero(law == number)
            if members.size == 0:
                continue
            # (3 * components, n) values of both fields, node by node
            columns = [
                np.moveaxis(field[:, triangles[:, members]], 0, 1).reshape(-1, members.size)
                for field in (self._nodes, self._values)
            ]
            for function in functions:
                result[members] += columnwise(function, members.size)(columns)[0].ravel()
        return result
