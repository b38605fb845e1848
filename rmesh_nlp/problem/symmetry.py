"""Symmetric halves: the support of a boundary that lies on an axis of symmetry."""

from __future__ import annotations

import numpy as np
from skfem import MeshTri

from rmesh_nlp.problem.statement import Dirichlet


def symmetric(mesh: MeshTri, boundary: str, components: int = 2) -> Dirichlet:
    """The support of a boundary on an axis: its nodes stay on it and carry no force along it.

    A scalar problem has no given value there: no flux is the natural condition, so the support is
    empty.

    Raises
    ------
    ValueError
        If the boundary is not parallel to an axis of coordinates.
    """
    nodes = np.unique(mesh.facets[:, mesh.boundaries[boundary]])
    extent = np.ptp(mesh.p[:, nodes], axis=1)
    flat = extent <= 1e-9 * float(np.max(np.ptp(mesh.p, axis=1)))
    if not np.any(flat):
        raise ValueError(
            f"the boundary {boundary!r} is not parallel to an axis: symmetry needs one that is, turn the mesh"
        )
    if components == 1:
        return Dirichlet(boundary, (None,))
    return Dirichlet(boundary, (0.0, None) if flat[0] else (None, 0.0))
