"""Rigid motions that the given displacements leave a body: what contact alone must prevent."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from rmesh_nlp.evaluation import ROUNDING, Array, magnitude
from rmesh_nlp.problem.data import ProblemData


def rigid_motions(problem: ProblemData, nodes: Array | None = None) -> Array:
    """A basis (motions, components, nodes) of the rigid motions that no given displacement prevents.

    Each belongs to one connected part of the mesh and is zero on the others; ``nodes`` are its positions,
    by default as given.
    """
    mesh = problem.mesh
    p = mesh.p if nodes is None else nodes
    held, _ = problem.held
    edges = sp.coo_array((np.ones(mesh.facets.shape[1]), tuple(mesh.facets)), shape=2 * (p.shape[1],))
    _, part = connected_components(edges, directed=False)
    motions = []
    for number in np.unique(part[mesh.t[0]]):
        modes = _modes(p, np.flatnonzero(part == number), problem.components)
        rows = modes[:, held]
        # of a triangular factor: with all rows the other singular vectors, thousands, would be made as well
        triangle = np.linalg.qr(rows.T, mode="r")
        basis = scipy.linalg.null_space(triangle, rcond=ROUNDING) if rows.size else np.eye(len(modes))
        motions += list(np.einsum("mk,mcn->kcn", basis, modes))
    return np.array(motions).reshape(-1, *held.shape)


def _modes(p: Array, part: NDArray, components: int) -> Array:
    """Translations, and for an elastic body the rotation, of one part: (modes, components, nodes)."""
    modes = np.zeros((1 if components == 1 else 3, components, p.shape[1]))
    for k in range(components):
        modes[k, k, part] = 1.0
    if components == 2:
        x, y = p[:, part] - p[:, part].mean(axis=1, keepdims=True)
        size = max(magnitude([x, y]), 1e-300)
        modes[2][:, part] = np.stack([-y, x]) / size
    return modes


def seen_by_contact(problem: ProblemData, motions: Array) -> Array:
    """Change of every gap (gaps, motions) by each motion."""
    rows = [np.zeros((0, len(motions)))]
    for part in problem.contact_sets:
        normals = problem.first_obstacles[part.number].normals(problem.mesh.p[:, part.nodes])
        rows.append(np.einsum("cn,mcn->nm", normals, motions[:, :, part.nodes]))
    return np.vstack(rows)
