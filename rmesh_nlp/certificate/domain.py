"""Whether relocation left the problem what it was: its domain, regions and boundary parts."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.certificate.skeleton import Skeleton, skeleton_of
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Place

SAME = 1e-10
"""Relative difference of areas, lengths and first moments up to which they are the same."""


def same_domain(problem: ContactProblem, nodes: Array) -> bool:
    """Whether regions and named boundaries in use have the same measures and moments as on the given mesh.

    Nodes that slide along straight pieces, and interior nodes, change none of them. A node that
    moves off its piece, or the end of a part that slides, changes its length, its area or a moment.
    """
    given, moved = (_moments(problem, skeleton_of(problem, x)) for x in (problem.mesh.p, nodes))
    return all(
        np.max(np.abs(a - b)) <= SAME * max(float(np.max(np.abs(a))), 1e-300)
        for a, b in zip(given, moved, strict=True)
    )


def _moments(problem: ContactProblem, skeleton: Skeleton) -> list[Array]:
    corner = skeleton.nodes.min(axis=1, keepdims=True)
    areas, centres = skeleton.areas, skeleton.centres - corner
    result = [np.array([areas[part].sum(), *(centres[:, part] @ areas[part])]) for _, part in problem.regions]
    names = {load.boundary for load in problem.tractions} | {s.boundary for s in problem.supports}
    names |= {o.boundary for o in problem.obstacles if not isinstance(o.boundary, Place)}
    middle = skeleton.nodes[:, skeleton.ends].mean(axis=1) - corner
    lengths = skeleton.lengths
    for name in sorted(names):
        edges = np.unique(problem.mesh.boundaries[name])
        result.append(np.array([lengths[edges].sum(), *(middle[:, edges] @ lengths[edges])]))
    return result
