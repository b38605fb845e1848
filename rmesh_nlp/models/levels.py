"""The same problem on a finer and on a coarser mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.curves import Curve
from rmesh_nlp.meshes.decimation import Lines, decimated
from rmesh_nlp.meshes.reading import from_arrays
from rmesh_nlp.meshes.unrefinement import Coarse, unrefined
from rmesh_nlp.problem import ContactProblem, Relative
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.lines import line_facets, on_curve, sliding_directions

COARSER = 4
"""How many times fewer nodes the next coarser mesh has."""

SHARES = (1 / COARSER, 0.33, 0.42, 0.5)
"""Parts of the nodes that are tried for a coarser mesh by taking nodes out."""

TURN = 0.6
"""Radians by which a curve may turn along an edge of a coarser mesh, or its arc cuts through triangles."""

WORTHWHILE = 2.0
"""Least factor by which a coarser mesh must be coarser."""


def coarsened(problem: ContactProblem, least: int = 60) -> ContactProblem | None:
    """The same problem on a coarser mesh with at least ``least`` nodes; None if there is none.

    The mesh of which the given one is the uniform refinement, if it is one and not too coarse; else nodes
    are taken out, fewer where the arcs of curves would cut through triangles. Nodes that the motion names by
    number stay, and are renumbered.
    """
    n = problem.mesh.p.shape[1]
    coarse = unrefined(problem.mesh)
    if coarse is not None and set(problem.motion.numbers) <= set(coarse.nodes.tolist()):
        return _on(problem, coarse, least)
    for share in SHARES if problem.motion.curves else SHARES[:1]:
        try:
            found = _on(problem, _decimated(problem, max(round(share * n), least)), least)
        except ValueError:
            continue  # nothing is left of a boundary or a subdomain
        if found is not None:
            return found
    return None


def _on(problem: ContactProblem, coarse: Coarse, least: int) -> ContactProblem | None:
    """The problem on a coarser mesh; None if that is not what it should be."""
    n, size = problem.mesh.p.shape[1], coarse.mesh.p.shape[1]
    if size < least or WORTHWHILE * size > n:
        return None
    number = {int(old): new for new, old in enumerate(coarse.nodes)}
    motion = problem.motion

    def renumbered(places: tuple[str | int, ...]) -> tuple[str | int, ...]:
        return tuple(place if isinstance(place, str) else number[place] for place in places)

    delta = motion.delta
    if isinstance(delta, Relative):
        delta = Relative(delta.fraction * np.sqrt(size / n))
    motion = replace(
        motion,
        delta=delta,
        pinned=renumbered(motion.pinned),
        slides=renumbered(motion.slides),
        free=renumbered(motion.free),
        tied=tuple((number[a], number[b]) for a, b in motion.tied),
    )
    try:
        found = replace(
            problem,
            mesh=coarse.mesh,
            motion=motion,
            size=f"{coarse.mesh.t.shape[1]} triangles",
            reference=None,
        )
    except ProblemError:
        return None  # too coarse for what the problem says
    return found if Body(found, found.mesh.p).is_upright() else None  # too coarse for its curves


def _turning(curve: Curve, nodes: NDArray[np.int64], points: Array) -> NDArray[np.int64]:
    """Some of the nodes on a curve, between which it turns by little more than ``TURN``."""
    t = curve.nearest(points[:, nodes])
    order = np.argsort(t)
    angle = np.unwrap(np.arctan2(*curve.velocity(t[order])[::-1]))
    turned = np.floor(np.abs(angle - angle[0]) / TURN)
    return nodes[order][np.append(True, np.diff(turned) > 0)]


def _decimated(problem: ContactProblem, target: int) -> Coarse:
    mesh, triangles = problem.mesh, problem.triangles
    on_line, tangent = sliding_directions(problem)
    kept = np.zeros(mesh.p.shape[1], dtype=bool)
    slides = np.any(tangent[:, on_line] != 0, axis=0) | (on_curve(problem)[on_line] >= 0)
    kept[on_line] = ~slides
    kept[list(problem.motion.numbers)] = True
    for name, curve in problem.motion.curves.items():
        kept[_turning(curve, problem.boundary_nodes((name,)), mesh.p)] = True
    result = decimated(mesh.p, triangles, Lines(kept, mesh.facets[:, line_facets(problem)]), target)
    nodes = np.unique(result.triangles)
    number = np.full(mesh.p.shape[1], -1)
    number[nodes] = np.arange(nodes.size)
    boundaries = {}
    for name, facets in (mesh.boundaries or {}).items():
        ends = result.into[mesh.facets[:, np.asarray(facets)]]
        ends = np.unique(np.sort(ends[:, ends[0] != ends[1]], axis=0), axis=1)
        boundaries[name] = number[ends].T
    place = np.full(mesh.t.shape[1], -1)
    place[result.element] = np.arange(result.element.size)
    subdomains = {
        name: place[np.asarray(elements)][place[np.asarray(elements)] >= 0]
        for name, elements in (mesh.subdomains or {}).items()
    }
    coarse = from_arrays(mesh.p[:, nodes].T, number[result.triangles].T, boundaries, subdomains)
    return Coarse(coarse, nodes)
