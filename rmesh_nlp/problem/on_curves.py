"""Nodes of a mesh on the curves that its boundaries were made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.curves import Curve

OFF = 1e-3
"""Distance from its curve, in units of the shortest edge of the boundary, at which a given node is not on it.
Mesh generators write nodes with 1e-10 or better; a wrong radius is off by more."""

EXACT = 1e-14
"""Distance, in units of the extent of the mesh, that is rounding."""


def nodes_of(mesh: MeshTri, name: str) -> NDArray[np.int64]:
    """Sorted numbers of the nodes on a named boundary."""
    return np.unique(mesh.facets[:, np.asarray(mesh.boundaries[name])]).astype(np.int64)


def onto_curves(mesh: MeshTri, curves: Mapping[str, Curve], *, anywhere: bool = False) -> MeshTri:
    """The mesh with the nodes of named boundaries exactly on their curves.

    Parameters
    ----------
    mesh : MeshTri
    curves : mapping from boundary names to Curve
    anywhere : bool
        Whether nodes may be far from their curve, as new ones in the middle of an edge are.

    Raises
    ------
    ValueError
        If a node is not on the curve that its boundary is said to be on.
    """
    moved = np.array(mesh.p, dtype=float)
    for name, curve in curves.items():
        nodes = nodes_of(mesh, name)
        places = curve.at(curve.nearest(mesh.p[:, nodes]))
        off = np.linalg.norm(places - mesh.p[:, nodes], axis=0)
        if not anywhere:
            a, b = mesh.facets[:, np.asarray(mesh.boundaries[name])]
            shortest = float(np.min(np.linalg.norm(mesh.p[:, a] - mesh.p[:, b], axis=0)))
            if np.max(off, initial=0.0) > OFF * shortest:
                worst = int(np.argmax(off))
                x, y = mesh.p[:, nodes[worst]]
                raise ValueError(
                    f"node {nodes[worst]} of {name!r} at ({x:.6g}, {y:.6g}) is {off[worst]:.3g} off its curve"
                )
        shifted = off > EXACT * float(np.max(np.ptp(mesh.p, axis=1)))
        moved[:, nodes[shifted]] = places[:, shifted]
    return mesh if np.array_equal(moved, mesh.p) else replace(mesh, doflocs=moved)


def parameters_of(curve: Curve, points: Array) -> tuple[Array, Array]:
    """Parameters (n,) of points (2, n) on a curve and the length (n,) of curve per unit of the parameter."""
    t = curve.nearest(points)
    return t, np.linalg.norm(curve.velocity(t), axis=0)
