"""The friction energy of a displacement: the integral of g |u_t| along the contact boundary."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rmesh_nlp.assessment.integrals import over_edges
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem.body import Body, Index
from rmesh_nlp.problem.coefficients import on_points
from rmesh_nlp.problem.contact_problem import ContactSet

STEPS = 3
"""Steps to the point of an edge at which the slip changes sign; one is exact on a straight foundation."""


def friction_energy(body: Body, contact: ContactSet, displacement: Array) -> tuple[float, float]:
    """Integral of the friction bound times the size of the slip, and what it may be wrong by.

    Edges are split where the slip changes sign.
    """
    obstacle = contact.obstacle
    edges = body.edges(str(obstacle.boundary))
    ends = displacement[:, edges.ends]

    def slip(rows: Index, s: Array, where: Array) -> Array:
        normals = obstacle.normals(where.reshape(2, -1)).reshape(where.shape)
        u = ends[:, 0, rows, None] * (1 - s) + ends[:, 1, rows, None] * s
        return np.asarray(normals[1] * u[0] - normals[0] * u[1])

    split = _zeros(lambda rows, s: slip(rows, s, edges.at(rows, s)[0]), edges.size)
    # each edge twice: before and behind the point where the slip changes sign
    low = np.concatenate([np.zeros(edges.size), split])
    width = np.concatenate([split, 1 - split])

    def at(part: Index, s: Array) -> tuple[Array, Array]:
        where, speed = edges.at(part % edges.size, low[part, None] + width[part, None] * s)
        return where, speed * width[part, None]

    def integrand(part: Index, s: Array, where: Array) -> Array:
        along = low[part, None] + width[part, None] * s
        bound = on_points(obstacle.friction, where.reshape(2, -1), "the friction bound")
        return (bound.reshape(s.shape) * np.abs(slip(part % edges.size, along, where)))[None]

    total, doubt = over_edges(at, 2 * edges.size, integrand)
    return float(np.sum(total)), float(np.sum(doubt))


def _zeros(slip: Callable[[Index, Array], Array], size: int) -> Array:
    """(edges,) where the slip changes sign, by the regula falsi; the middle where it does not."""
    rows = np.arange(size)
    low, high = np.zeros(size), np.ones(size)
    at_low, at_high = (slip(rows, s[:, None])[:, 0] for s in (low, high))
    changes = at_low * at_high < 0
    middle = np.full(size, 0.5)
    for _ in range(STEPS):
        slope = np.where(changes, at_high - at_low, 1.0)
        middle = np.where(changes, low - at_low * (high - low) / slope, 0.5)
        here = slip(rows, middle[:, None])[:, 0]
        same = here * at_low > 0
        low, at_low = np.where(same, middle, low), np.where(same, here, at_low)
        high, at_high = np.where(same, high, middle), np.where(same, at_high, here)
        changes = changes & (here != 0)
    return middle
