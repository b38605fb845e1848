"""The same problem on a finer mesh: every triangle cut, or some of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.reading import from_arrays
from rmesh_nlp.problem.contact_problem import ContactProblem
from rmesh_nlp.problem.motion import Relative
from rmesh_nlp.problem.on_curves import onto_curves


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


def locally_refined(problem: ContactProblem, elements: NDArray) -> ContactProblem:
    """The problem with some triangles refined, and what neighbours need; old nodes keep their numbers."""
    old = problem.mesh
    new = replace(old, _boundaries=None).refined(np.asarray(elements))
    keys = {tuple(edge) for edge in np.sort(new.facets, axis=0).T.tolist()}
    tree = cKDTree(new.p.T)
    boundaries = {}
    for name, facets in (old.boundaries or {}).items():
        edges = []
        for a, b in old.facets[:, np.asarray(facets)].T.tolist():
            if (min(a, b), max(a, b)) in keys:
                edges.append((a, b))
                continue
            middle = int(tree.query((old.p[:, a] + old.p[:, b]) / 2)[1])
            edges += [(a, middle), (middle, b)]
        boundaries[name] = np.array(edges)
    subdomains = {name: np.asarray(e) for name, e in (new.subdomains or {}).items()}
    mesh = from_arrays(new.p.T, counter_clockwise(new.p, new.t).T, boundaries, subdomains)
    mesh = onto_curves(mesh, problem.motion.curves, anywhere=True)
    return replace(problem, mesh=mesh, size=f"{mesh.t.shape[1]} triangles", reference=None)
