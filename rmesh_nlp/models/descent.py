"""Descents of an outer objective by Newton-CG, where move limits or a distortion keep the elements valid.

With a distortion each outer variable has a trust region of its own: a uniform radius is held back everywhere
by the smallest element.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array, cross
from rmesh_nlp.fem.fields import NONE
from rmesh_nlp.models.energy_nlp import Relocation
from rmesh_nlp.models.reduced_model import Reduced
from rmesh_nlp.optimize.trust_region import Evaluation, LocalRadii, NewtonResult, minimise
from rmesh_nlp.problem import signed_areas

Watch = Callable[[int, Array], bool]
"""Called as ``watch(iteration, q)`` with outer variables that have been evaluated; True ends the descent."""

KEPT = 0.1
"""Part of its present area that a step leaves to every element."""


def descend(
    function: Reduced,
    q: Array,
    is_valid: Callable[[Array], bool],
    watch: Watch,
    **options: Any,
) -> NewtonResult:
    """Descend from outer variables ``q``.

    ``options`` are those of :func:`rmesh_nlp.optimize.trust_region.minimise`. Points at which elements are
    not valid are not taken.
    """
    relocation = function.energy.relocation
    has_barrier = function.objective.has_barrier
    is_guarded = has_barrier or relocation.n_valid > 0

    def evaluate(x: Array) -> Evaluation | None:
        if is_guarded and not is_valid(x):
            return None
        point = function(x)
        if not np.isfinite(point.value):
            return None
        return Evaluation(point.value, point.gradient, lambda: function.hessian(point))

    local = LocalRadii(
        lambda x: node_widths(relocation, x), lambda x, step: longest_valid(relocation, x, step)
    )
    return minimise(
        evaluate,
        q,
        relocation.parts.mesh_map.lower,
        relocation.parts.mesh_map.upper,
        local=local if has_barrier else None,
        on_step=watch,
        **options,
    )


def node_widths(relocation: Relocation, q: Array) -> Array:
    """Least height of the elements at the node behind each outer variable, in the unit of the variable."""
    triangles, positions = relocation.parts.problem.triangles, relocation.parts.mesh_map.positions
    nodes = relocation.nodes(q)
    corner = nodes[:, triangles]
    edges = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=0)
    height = 2 * np.abs(signed_areas(nodes, triangles)) / edges.max(axis=0)
    least = np.full(nodes.shape[1], np.inf)
    for vertices in triangles:
        np.minimum.at(least, vertices, height)
    index = positions.index
    moving = index != NONE
    # a variable behind both coordinates, or of several tied nodes, is as wide as the narrowest allows
    steps = np.zeros(q.size)
    np.maximum.at(steps, index[moving], np.abs(positions.slopes(q))[moving])
    room = np.full(q.size, np.inf)
    np.minimum.at(room, index[moving], np.broadcast_to(least, index.shape)[moving])
    return room / np.maximum(steps, 1e-300)


def longest_valid(relocation: Relocation, q: Array, step: Array) -> float:
    """Part of a step, at most 1, that leaves every element ``KEPT`` of its area.

    The area is quadratic along the step; its first root is computed without cancellation.
    """
    triangles = relocation.parts.problem.triangles
    nodes = relocation.nodes(q)
    move = (relocation.nodes(q + step) - nodes)[:, triangles]
    (a, b), (u, v) = ((of[:, 1:] - of[:, :1]).swapaxes(0, 1) for of in (nodes[:, triangles], move))
    constant = (1 - KEPT) * cross(a, b)
    linear = cross(a, v) + cross(u, b)
    square = cross(u, v)
    discriminant = linear**2 - 4 * square * constant
    with np.errstate(all="ignore"):
        middle = -0.5 * (linear + np.where(linear >= 0, 1.0, -1.0) * np.sqrt(discriminant))
        roots = np.stack([middle / square, constant / middle])
    real = np.isfinite(roots) & (roots > 0)
    return float(min(1.0, np.min(roots[real], initial=1.0)))
