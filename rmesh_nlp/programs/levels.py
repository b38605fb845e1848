"""The same problem on a finer and on a coarser mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.errors import ProblemError
from rmesh_nlp.meshes.decimation import Lines, decimated
from rmesh_nlp.meshes.reading import from_arrays
from rmesh_nlp.meshes.unrefinement import Coarse, unrefined
from rmesh_nlp.problem import ContactProblem, Relative
from rmesh_nlp.problem.lines import line_facets, on_curve, sliding_directions
from rmesh_nlp.problem.on_curves import onto_curves

COARSER = 4
"""How many times fewer nodes the next coarser mesh has."""

WORTHWHILE = 2.0
"""Least factor by which a coarser mesh must be coarser."""


def refined(problem: ContactProblem, *, polygon: bool = False) -> ContactProblem:
    """The same problem with every triangle cut into four, names kept; boxes keep their widths.

    New nodes of a boundary with a curve are on the curve. With ``polygon`` they stay on the edges that
    they cut, and the motion has no curves: the domain is then that of the given mesh.
    """
    motion = problem.motion
    if isinstance(motion.delta, Relative):
        motion = replace(motion, delta=Relative(2 * motion.delta.fraction))
    mesh = problem.mesh.refined(1)
    if polygon:
        motion = replace(motion, curves={})
    mesh = onto_curves(mesh, motion.curves, anywhere=True)
    return replace(problem, mesh=mesh, motion=motion, size=f"{mesh.t.shape[1]} triangles", reference=None)


def coarsened(problem: ContactProblem, least: int = 60) -> ContactProblem | None:
    """The same problem on a coarser mesh with at least ``least`` nodes; None if there is none.

    The mesh of which the given one is the uniform refinement, if it is one and not too coarse; else nodes
    are taken out. Nodes that the motion names by number stay, and are renumbered.
    """
    n = problem.mesh.p.shape[1]
    coarse = unrefined(problem.mesh)
    if coarse is None or not set(problem.motion.numbers) <= set(coarse.nodes.tolist()):
        try:
            coarse = _decimated(problem, max(n // COARSER, least))
        except ValueError:
            return None  # nothing is left of a boundary or a subdomain
    size = coarse.mesh.p.shape[1]
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
        return replace(
            problem,
            mesh=coarse.mesh,
            motion=motion,
            size=f"{coarse.mesh.t.shape[1]} triangles",
            reference=None,
        )
    except ProblemError:
        return None  # too coarse for what the problem says


def _decimated(problem: ContactProblem, target: int) -> Coarse:
    mesh, triangles = problem.mesh, problem.triangles
    on_line, tangent = sliding_directions(problem)
    kept = np.zeros(mesh.p.shape[1], dtype=bool)
    slides = np.any(tangent[:, on_line] != 0, axis=0) | (on_curve(problem)[on_line] >= 0)
    kept[on_line] = ~slides
    kept[list(problem.motion.numbers)] = True
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
