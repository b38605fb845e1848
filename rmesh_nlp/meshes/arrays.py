"""Meshes from arrays, with named boundaries and subdomains.

What can be repaired without guessing is repaired and said so by a :class:`MeshRepairWarning`:
clockwise triangles are turned, duplicate nodes merged, unused nodes dropped. Anything else
that is wrong is a ValueError. Names of boundaries may overlap (a load on a part of the top).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import ROUNDING, Index, largest_side
from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import counter_clockwise, edge_keys, mismatch, signed_areas
from rmesh_nlp.settings import ByName


class MeshRepairWarning(UserWarning):
    """A mesh was repaired; the message says how."""


def from_arrays(
    nodes: ArrayLike,
    triangles: ArrayLike,
    boundaries: ByName | None = None,
    subdomains: ByName | None = None,
    pairs: Collection[tuple[str, str]] = (),
) -> MeshTri:
    """A mesh from ``nodes`` (nodes, 2) and ``triangles`` (elements, 3).

    Parameters
    ----------
    boundaries, subdomains : mappings, optional
        Names of edges, each an (edges, 2) array of node numbers or a predicate of the edge
        midpoints ``x`` (2, edges) of the outer boundary; names of triangles, each an array of
        numbers or a predicate of their midpoints.
    pairs : tuples of two names, optional
        Boundaries, given by node numbers, whose nodes may be at the same places and stay two each.

    Raises
    ------
    ValueError
        If an array has the wrong shape or a value that is not finite, a triangle has a
        missing or repeated node, no area, or covers another, a node hangs on an edge, or a name is empty.
    """
    names, (p, t) = boundaries or {}, _checked(np.array(nodes, dtype=float), np.array(triangles))
    p, t, number = _without_duplicates(p, t, [[names.get(n, ()) for n in both] for both in pairs])
    used = np.unique(t)
    if used.size < p.shape[1]:
        repaired(f"dropped {p.shape[1] - used.size} nodes that belong to no triangle")
        new = np.full(p.shape[1], -1)
        new[used] = np.arange(used.size)
        p, t, number = p[:, used], new[t], new[number]
    areas = signed_areas(p, t)
    if np.any(areas < 0):
        repaired(f"turned {np.sum(areas < 0)} clockwise triangles")
        t = counter_clockwise(p, t)
    mesh = MeshTri(np.ascontiguousarray(p), np.ascontiguousarray(t))
    if wrong := fault(mesh):
        for both in pairs:
            if {*both} <= {*names}:
                wrong = mismatch(p, [np.ravel(number[names[n]]) for n in both], both) or wrong
        raise BadInputError(wrong)
    return _named(mesh, names, subdomains or {}, number)


def named(
    mesh: MeshTri,
    boundaries: ByName | None = None,
    subdomains: ByName | None = None,
) -> MeshTri:
    """The mesh with further names, given as in :func:`from_arrays`."""
    return _named(mesh, boundaries or {}, subdomains or {}, np.arange(mesh.p.shape[1]))


def _checked(p: NDArray, t: NDArray) -> tuple[NDArray, Index]:
    """Nodes (2, nodes) and triangles (3, elements) whose numbers are theirs."""
    if p.ndim != 2 or p.shape[1] != 2:
        raise BadInputError(f"nodes must be an array of shape (nodes, 2), got {p.shape}")
    for node in np.flatnonzero(~np.all(np.isfinite(p), axis=1)):
        raise BadInputError(f"node {node} is at ({p[node, 0]}, {p[node, 1]})")
    if t.ndim != 2 or t.shape[1] != 3 or t.shape[0] == 0:
        raise BadInputError(f"triangles must be an array of shape (elements, 3), got {t.shape}")
    if not np.issubdtype(t.dtype, np.integer):
        raise BadInputError(f"triangles must hold node numbers, got values of type {t.dtype}")
    for bad in np.flatnonzero(np.any((t < 0) | (t >= len(p)), axis=1)):
        raise BadInputError(
            f"triangle {bad} has nodes {t[bad].tolist()}, but nodes run from 0 to {len(p) - 1}"
        )
    return p.T, t.astype(np.int64).T


def _without_duplicates(p: NDArray, t: Index, apart: list[list[Any]]) -> tuple[NDArray, Index, Index]:
    """Nodes at one place merged, but for those of two boundaries apart; also the new number of each node."""
    pairs = cKDTree(p.T).query_pairs(ROUNDING * largest_side(p), output_type="ndarray")
    number = np.arange(p.shape[1])
    for first, second in apart:
        on = [np.isin(pairs, np.ravel(each)) for each in (first, second)]
        pairs = pairs[~np.any(on[0] & on[1][:, ::-1], axis=1)]
    for a, b in pairs[np.argsort(pairs[:, 1])]:
        number[b] = number[a]
    merged = np.unique(number)
    if merged.size < p.shape[1]:
        if np.any(np.isin(np.flatnonzero(number != np.arange(number.size)), t)):
            repaired(f"merged {p.shape[1] - merged.size} duplicate nodes")
        number = np.searchsorted(merged, number)
        p, t = p[:, merged], number[t]
    for triangle in np.flatnonzero((t[0] == t[1]) | (t[1] == t[2]) | (t[0] == t[2])):
        raise BadInputError(f"triangle {triangle} has a repeated node")
    return p, t, number


def _named(mesh: MeshTri, boundaries: ByName, subdomains: ByName, number: Index) -> MeshTri:
    size = mesh.p.shape[1]
    keys = edge_keys(mesh.facets, size)

    def facets_of(name: str, edges: NDArray) -> Index:
        """Numbers of the facets between pairs of nodes (edges, 2), these by their old numbers."""
        if edges.size and (edges.ndim != 2 or edges.shape[1] != 2):
            raise BadInputError(
                f"the boundary {name!r} must be an array of shape (edges, 2), got {edges.shape}"
            )
        wanted = edge_keys(number[edges.reshape(-1, 2).T], size)
        found = np.searchsorted(keys, wanted) % keys.size  # scikit-fem sorts facets
        for a, b in edges[keys[found] != wanted]:
            raise BadInputError(
                f"the boundary {name!r} has the edge ({a}, {b}), which is no edge of a triangle"
            )
        return np.unique(found)

    facets = {
        name: _chosen(mesh.p[:, mesh.facets], value, mesh.boundary_facets())
        if callable(value)
        else facets_of(name, np.asarray(value, int))
        for name, value in boundaries.items()
    }
    elements = {
        name: _chosen(mesh.p[:, mesh.t], value, np.arange(mesh.nelements))
        if callable(value)
        else np.unique(np.asarray(value, dtype=np.int64))
        for name, value in subdomains.items()
    }
    for name, members in elements.items():
        if np.any((members < 0) | (members >= mesh.nelements)):
            raise BadInputError(f"the subdomain {name!r} has a triangle that the mesh has not")
    for kind, names in (("boundary", facets), ("subdomain", elements)):
        for name, members in names.items():  # scikit-fem would drop empty ones silently
            if members.size == 0:
                raise BadInputError(f"the {kind} {name!r} is empty")
    mesh = mesh.with_boundaries({**(mesh.boundaries or {}), **facets}) if facets else mesh
    return mesh.with_subdomains({**(mesh.subdomains or {}), **elements}) if elements else mesh


def _chosen(corners: NDArray, predicate: Callable[[Any], Any], among: Index) -> Index:
    inside = np.asarray(predicate(corners.mean(axis=1)[:, among]), dtype=bool)
    return np.asarray(among[np.broadcast_to(inside, among.shape)], dtype=np.int64)


def repaired(message: str) -> None:
    """Tell of a repair."""
    warnings.warn(message, MeshRepairWarning, stacklevel=4)
