"""Remeshing by Mmg, as mmgpy wraps it.

(C. Dapogny, C. Dobrzynski, P. Frey, J. Comput. Phys. 262 (2014) 358-378.)
"""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse import csgraph
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array, Index, largest_side
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.geometry import counter_clockwise, named_by_user

MISSING = "remeshing needs Mmg: pip install 'rmesh-nlp[remesh]'"

REPLACED = (signal.SIGABRT, signal.SIGFPE, signal.SIGILL, signal.SIGINT, signal.SIGSEGV, signal.SIGTERM)
"""Signals that Mmg has handlers of its own for, at its beginning."""

PERIOD = 1e-3
"""Seconds after which they are put back again."""


def is_available() -> bool:
    """Whether mmgpy is installed."""
    return find_spec("mmgpy") is not None


def remeshed(mesh: MeshTri, tensors: Array, lines: Index, fixed: Index, off_curves: float = 0.0) -> MeshTri:
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

    Raises
    ------
    BadInputError
        If mmgpy is not installed, or Mmg gives up.
    """
    if not is_available():
        raise BadInputError(MISSING)
    from mmgpy import MmgMesh2D

    edge_sets, edge_mark = _marks(mesh.boundaries, lines)
    piece = _pieces(mesh, lines)
    cell_sets, cell_mark = _marks(mesh.subdomains, np.arange(mesh.t.shape[1]), piece)
    work = MmgMesh2D()
    work.set_mesh_size(vertices=mesh.p.shape[1], triangles=mesh.t.shape[1], edges=lines.size)
    work.set_vertices(np.ascontiguousarray(mesh.p.T))
    work.set_triangles(_rows(counter_clockwise(mesh.p, mesh.t)), cell_mark)
    work.set_edges(_rows(mesh.facets[:, lines]), edge_mark)
    first, second = mesh.f2t[:, lines]
    ends_inside = np.flatnonzero((second >= 0) & (piece[first] == piece[second]))
    work.set_required_edges(ends_inside.astype(np.int32))  # Mmg follows lines between two pieces only
    work.set_corners(fixed.astype(np.int32))
    work.set_required_vertices(fixed.astype(np.int32))
    work["tensor"] = np.ascontiguousarray(tensors.T)
    size = largest_side(mesh.p)
    try:
        with _own_signals():  # sizes change as fast as the metric says
            work.remesh(verbose=-1, hgrad=-1.0, hausd=off_curves or size)
    except RuntimeError as error:
        raise BadInputError(f"Mmg cannot remesh this domain: {error}") from error
    triangles, cell_mark = work.get_triangles_with_refs()
    edges, edge_mark = work.get_edges_with_refs()
    used, flat = np.unique(triangles, return_inverse=True)
    number = np.full(int(np.max(edges, initial=0)) + 1, -1)
    number[used[used < number.size]] = np.flatnonzero(used < number.size)
    try:
        return from_arrays(
            work.get_vertices()[used],
            flat.reshape(-1, 3),
            {name: number[edges[np.isin(edge_mark, marks)]] for name, marks in edge_sets.items()},
            {name: np.flatnonzero(np.isin(cell_mark, marks)) for name, marks in cell_sets.items()},
        )
    except ValueError as error:
        raise BadInputError(f"the mesh that Mmg made is not in order: {error}") from error


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep the handlers of signals that Mmg replaces, of which its own one for Ctrl-C ends the process.

    Ctrl-C waits until Mmg is done. This thread blocks it; a guard puts the handlers back at once, since
    any other thread may get the signal instead. They are those of C, so that it works in any thread.
    """
    get, put = ctypes.pythonapi.PyOS_getsig, ctypes.pythonapi.PyOS_setsig
    get.argtypes, get.restype = [ctypes.c_int], ctypes.c_void_p
    put.argtypes, put.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_void_p
    before = {number: get(number) for number in REPLACED}
    has_mask, done = hasattr(signal, "pthread_sigmask"), threading.Event()

    def put_back() -> None:
        for number, handler in before.items():
            put(number, handler)

    def watch() -> None:
        while not done.wait(PERIOD):
            put_back()

    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if has_mask else set()
    guard = threading.Thread(target=watch, name="signals", daemon=True)  # with the same mask
    guard.start()
    try:
        yield
    finally:
        done.set()
        guard.join()
        put_back()
        if has_mask:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _pieces(mesh: MeshTri, lines: Index) -> Index:
    """A number (elements,) for each piece that the lines cut the domain into."""
    a, b = mesh.f2t[:, np.setdiff1d(np.flatnonzero(mesh.f2t[1] >= 0), lines)]
    n = mesh.t.shape[1]
    beside = sp.coo_array((np.ones(a.size), (a, b)), shape=(n, n))
    return csgraph.connected_components(beside, directed=False)[1]


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
