"""How far nodes can go within their move limits, and how small triangles can so become."""

from __future__ import annotations

from itertools import product

import numpy as np

from rmesh_nlp.evaluation import Array, Index, cross
from rmesh_nlp.fem.fields import NONE, Field
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.vectorised import CHUNK


def corners(problem: ContactProblem, positions: Field, nodes: Array) -> Array:
    """(2, 4, nodes) the corners of the limits of each node around ``nodes`` (2, nodes).

    They are infinite where there are no limits: those along curves and of shapes count as none.
    """
    moves = positions.scale != 0
    reach = np.where(moves, np.inf, 0.0) if problem.motion.delta is None else positions.scale
    if positions.bends is not None:
        reach = np.where((positions.bends.which != NONE) & moves, np.inf, reach)
    if positions.modes is not None:
        reach = np.where(np.any(positions.modes.motions != 0, axis=0), np.inf, reach)
    alike = positions.index[0] == positions.index[1]  # one outer variable moves both coordinates
    signs = [
        np.array([np.full(alike.shape, x), np.where(alike, x, y)]) for x, y in product((-1, 1), repeat=2)
    ]
    return np.stack([nodes + reach * sign for sign in signs], axis=1)


def least_areas(limits: Array, triangles: Index) -> Array:
    """Least signed area of each triangle whose vertices stay within corners (2, 4, nodes).

    It is -infinity where a vertex has no limits. The area is affine in each vertex: it is least at corners.
    """
    least = np.full(triangles.shape[1], -np.inf)
    finite = np.all(np.isfinite(limits), axis=(0, 1))
    limited = np.flatnonzero(np.all(finite[triangles], axis=0))
    for part in np.array_split(limited, range(CHUNK, limited.size, CHUNK)):
        a, b, c = (limits[:, :, vertices] for vertices in triangles[:, part])
        b, c = b[:, None, :, None] - a[:, :, None, None], c[:, None, None] - a[:, :, None, None]
        least[part] = np.min(cross(b, c), axis=(0, 1, 2)) / 2
    return least
