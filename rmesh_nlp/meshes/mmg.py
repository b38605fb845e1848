"""Remeshing by Mmg, as mmgpy wraps it.

(C. Dapogny, C. Dobrzynski, P. Frey, J. Comput. Phys. 262 (2014) 358-378.)
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Index, largest_side
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.geometry import counter_clockwise, named_by_user, pieces_of
from rmesh_nlp.optimize.process import Process, packed, serve, unpacked

MISSING = "remeshing needs Mmg: pip install 'rmesh-nlp[remesh]'"

LARGEST = 1_000_000
"""Nodes of a new mesh at most."""

_mmg = Process("rmesh_nlp.meshes.mmg")


def is_available() -> bool:
    """Whether mmgpy is installed."""
    return find_spec("mmgpy") is not None


def remeshed(
    mesh: MeshTri,
    tensors: Array,
    lines: Index,
    fixed: Index,
    off_curves: float = 0.0,
) -> MeshTri:
    """A mesh of the same domain whose edges have about length one in a metric; names are kept.

    Parameters
    ----------
    mesh : MeshTri
    tensors : (3, nodes) array
        Entries xx, xy, yy of the metric at its nodes, in one over length squared.
    lines : (n,) int array
        Facets on lines that the new edges must follow: boundary, interfaces, named parts. Lines that end
        within one piece of the domain keep their edges.
    fixed : (m,) int array
        Nodes that stay: corners, ends of parts.
    off_curves : float
        How far new edges on curved lines may be from the arc, in units of length; 0 if there are none.

    Mmg runs in a process of its own, which is killed when time is over or Ctrl-C comes.

    Raises
    ------
    BadInputError
        If mmgpy is not installed, or Mmg gives up.
    """
    if not is_available():
        raise BadInputError(MISSING)
    edge_sets, edge_mark = _marks(mesh.boundaries, lines)
    piece = _pieces(mesh, lines)
    cell_sets, cell_mark = _marks(mesh.subdomains, np.arange(mesh.nelements), piece)
    first, second = mesh.f2t[:, lines]
    ends_inside = np.flatnonzero((second >= 0) & (piece[first] == piece[second]))
    given = (
        np.ascontiguousarray(mesh.p.T),
        _rows(counter_clockwise(mesh.p, mesh.t)),
        cell_mark,
        _rows(mesh.facets[:, lines]),
        edge_mark,
        ends_inside.astype(np.int32),  # Mmg follows lines between two pieces only
        fixed.astype(np.int32),
        np.ascontiguousarray(tensors.T),
        off_curves or largest_side(mesh.p),
    )
    answer = _mmg.ask(packed(given))
    if answer.line is None:
        raise BadInputError(f"Mmg cannot remesh this domain: it ended with code {answer.code}")
    made = unpacked(answer.line)
    if isinstance(made, str):
        raise BadInputError(f"Mmg cannot remesh this domain: {made}")
    vertices, triangles, cell_mark, edges, edge_mark = made
    used, flat = np.unique(triangles, return_inverse=True)
    number = np.full(int(np.max(edges, initial=0)) + 1, -1)
    number[used[used < number.size]] = np.flatnonzero(used < number.size)
    try:
        return from_arrays(
            vertices[used],
            flat.reshape(-1, 3),
            {name: number[edges[np.isin(edge_mark, marks)]] for name, marks in edge_sets.items()},
            {name: np.flatnonzero(np.isin(cell_mark, marks)) for name, marks in cell_sets.items()},
        )
    except ValueError as error:
        raise BadInputError(f"the mesh that Mmg made is not in order: {error}") from error


def _pieces(mesh: MeshTri, lines: Index) -> Index:
    """A number (elements,) for each piece that the lines cut the domain into."""
    return pieces_of(mesh.f2t[:, np.setdiff1d(np.flatnonzero(mesh.f2t[1] >= 0), lines)], mesh.nelements)


def _marks(
    groups: Mapping[str, Any] | None, chosen: Index, piece: Index | None = None
) -> tuple[dict[str, Index], Index]:
    """The marks of each name, and the mark (chosen,) of each member.

    There is one for every combination of names and number of a ``piece`` (chosen,).
    """
    named = named_by_user(groups)
    member = np.array([np.isin(chosen, part) for part in named.values()]).reshape(len(named), chosen.size)
    pieces = np.zeros(chosen.size, dtype=np.int64) if piece is None else piece
    kinds, mark = np.unique(np.vstack([member, pieces]).T, axis=0, return_inverse=True)
    sets = {name: 1 + np.flatnonzero(kinds[:, number]) for number, name in enumerate(named)}
    return sets, (1 + mark.ravel()).astype(np.int64)


def _rows(columns: Any) -> NDArray[np.int32]:
    return np.ascontiguousarray(columns.T, dtype=np.int32)


def _made(line: bytes) -> bytes:
    """Vertices, and triangles and edges with their marks, or why there are none."""
    from mmgpy import MmgMesh2D

    vertices, triangles, cell_mark, edges, edge_mark, required, fixed, tensors, off = unpacked(line)
    work = MmgMesh2D()
    work.set_mesh_size(vertices=len(vertices), triangles=len(triangles), edges=len(edges))
    work.set_vertices(vertices)
    work.set_triangles(triangles, cell_mark)
    work.set_edges(edges, edge_mark)
    work.set_required_edges(required)
    work.set_corners(fixed)
    work.set_required_vertices(fixed)
    work["tensor"] = tensors
    made: Any
    try:  # sizes change as fast as the metric says
        work.remesh(verbose=-1, hgrad=-1.0, hausd=off)
        made = work.get_vertices(), *work.get_triangles_with_refs(), *work.get_edges_with_refs()
    except RuntimeError as error:
        made = str(error)
    return packed(made)


if __name__ == "__main__":
    serve(_made)
