"""What relocation can gain, and the weight of a distortion in the energy relative to it.

``energy + w * distortion`` has a limit as the mesh is refined if ``w`` falls like the error of the energy:
then the best positions are a map of the domain that hardly depends on the mesh. So the weight is given as a
part of that error (:func:`gain_estimate`), which also makes one number suit every load and unit.

The gain of energy by a new node on each edge says where to refine, for any law, load and contact
(:func:`edge_gains`). Triangles are marked by their share of the sum (W. Dörfler, SIAM J. Numer. Anal. 33
(1996) 1106-1124).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.assessment.error_reduction import on_refined
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import BadInputError, ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.distortion import DISTORTIONS
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.flips import ElementEnergies
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem

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
        plus, here, minus = (energy(i, step) for step in (scale, 0.0, -scale))
        # the energy is quadratic in each value
        rates = (plus - minus) / (2 * scale), (plus - 2 * here + minus) / scale**2
        slope, curvature = (np.bincount(facet_of.ravel(), rate, n_facets) for rate in rates)
        part = np.where(curvature > 0, slope**2 / (2 * np.maximum(curvature, 1e-300)), 0.0)
        gain += np.where(free[i], part, 0.0)
    sides = np.bincount(facet_of.ravel(), minlength=n_facets)
    return np.asarray((gain / np.maximum(sides, 1))[facet_of].sum(axis=0))


EXTRAPOLATION = 4 / 3
"""Error of the energy over its decrease by one uniform refinement, if the error falls by four."""

LEAST_GAIN = 1e-9
"""Least error of the energy, in parts of the energy, that a weight is made of."""


@dataclass(frozen=True)
class GainEstimate:
    """Energy of the continuous problem on a mesh, and its error: the most that relocation can gain."""

    energy: float
    value: float


ESTIMATE_SOLVES = 2
"""Contact solves of an estimate."""


def gain_estimate(problem: ContactProblem | ContactSolver) -> GainEstimate:
    """Estimate the error of the continuous energy of the mesh as given, by two contact solves.

    Where the contact problem cannot be solved on the refined mesh, or its energy does not fall, the gains of
    new nodes on edges estimate it.
    """
    solver = problem if isinstance(problem, ContactSolver) else ContactSolver(problem)
    here = admissible(solver.discretisation, start=solver.given.active)
    there = _refined(here)
    floor = LEAST_GAIN * max(abs(here.energy), 1e-300)
    if there is not None and there.status is Status.CONVERGED and there.energy < here.energy:
        return GainEstimate(here.energy, max(EXTRAPOLATION * (here.energy - there.energy), floor))
    return GainEstimate(here.energy, max(float(edge_gains(solver.problem).sum()), floor))


def _refined(here: Admissible) -> Admissible | None:
    try:
        return on_refined(here)
    except ProblemError:  # new nodes on a curve fold a thin element
        return None


def weights(regularisation: float | str | Sequence[float], name: str = "regularisation") -> tuple[float, ...]:
    """A schedule of relative weights, checked: positive and finite numbers, of which the last may be zero.

    A text has its numbers separated by commas.

    A BadInputError says what is wrong with one.
    """
    text = regularisation.split(",") if isinstance(regularisation, str) else regularisation
    given = text if isinstance(text, Sequence) else (text,)
    try:
        values = tuple(float(value) for value in given)
    except (TypeError, ValueError):
        raise BadInputError(f"{name} must be a number or a list of numbers, got {regularisation!r}") from None
    if not values or not all(np.isfinite(v) and v >= 0 for v in values) or 0 in values[:-1]:
        raise BadInputError(
            f"{name} must be positive and finite, and only its last value may be 0, got {regularisation!r}"
        )
    return values


def regularised(gain: float, weight: float, distortion: str = "shape-size") -> Objective:
    """``energy + weight * gain * distortion``; the energy alone if the weight is 0."""
    if distortion not in DISTORTIONS:
        raise BadInputError(f"unknown distortion {distortion!r}: choose from {', '.join(DISTORTIONS)}")
    if weight == 0:
        return parse_objective("energy")
    return parse_objective(f"energy + {weight * gain:.6g}*{distortion}")
