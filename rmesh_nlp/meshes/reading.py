"""Meshes in: arrays, and any file that meshio reads, with their groups as names.

What can be repaired without guessing is repaired and said so by a :class:`MeshRepairWarning`:
clockwise triangles are turned, duplicate nodes merged, unused nodes dropped. Anything else
that is wrong is a ValueError. Names of boundaries may overlap (a load on a part of the top).
"""

from __future__ import annotations

import contextlib
import io
import re
import signal
import threading
import warnings
import xml.etree.ElementTree
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.meshes.embedding import fault
from rmesh_nlp.meshes.geometry import counter_clockwise, overlapping, signed_areas

LARGEST_FILE = 500_000_000
"""Bytes that a mesh file may have: some five million nodes as text."""

SECONDS, SECONDS_PER_BYTE = 10.0, 2e-6
"""Longest time of the processor to read a file: meshio takes about 2e-7 seconds per byte of text."""


class _TooLongError(Exception):
    pass


def read_file(path: Path) -> meshio.Mesh:
    """The mesh of a file, read in the format of its extension and no other.

    Some of meshio's readers never come to the end of a damaged file, so their time is limited.

    Raises
    ------
    ValueError
        If it cannot be read, is too large, or takes too long.
    """
    kind = _format(path)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ValueError(f"{path}: cannot be read as a mesh: {error.strerror}") from error
    if not path.is_file():
        raise ValueError(f"{path}: cannot be read as a mesh: it is not a file")
    if size == 0:
        raise ValueError(f"{path}: cannot be read as a mesh: it is empty{AGAIN}")
    if size > LARGEST_FILE:
        raise ValueError(f"{path}: has {size} bytes: of a mesh no more than {LARGEST_FILE} are read")
    seconds = SECONDS + SECONDS_PER_BYTE * size
    said = io.StringIO()  # meshio prints what it dislikes
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()), _no_warnings():
            return _limited(lambda: meshio.read(path, kind), seconds)
    except _TooLongError:
        raise ValueError(
            f"{path}: cannot be read as a mesh: the reader of {kind} found no end within {seconds:.0f} s; "
            "the file may be damaged"
        ) from None
    except (SystemExit, Exception) as error:  # meshio's readers raise anything, some call sys.exit
        reason = _reason(error, said.getvalue())
        raise ValueError(f"{path}: cannot be read as a mesh of the format {kind}: {reason}") from error


AGAIN = "; export it again, as .msh of gmsh or .vtu if it can be"

NO_NUMBER = re.compile(r"(?:could not convert string to float|invalid literal for int\(\).*?): (.*)")

INTERNAL = (AssertionError, AttributeError, IndexError, TypeError, NameError)
"""Errors of a reader that met what it was not made for; their texts speak of its code."""


def _reason(error: BaseException, said: str) -> str:
    """One line for people on why a reader of meshio gave up, and what to do."""
    if isinstance(error, ModuleNotFoundError):
        return f"this format needs the package {error.name}: pip install {error.name}"
    text = " ".join(str(error).split())
    number = NO_NUMBER.match(text)
    if isinstance(error, SystemExit):  # its reason was printed
        lines = [line for line in said.splitlines() if re.match(r"\s*[A-Za-z]", line)]
        text = lines[-1].strip() if lines else "its content is in another format"
    elif isinstance(error, UnicodeDecodeError):
        text = "it is not a text file"
    elif isinstance(error, xml.etree.ElementTree.ParseError):
        text = f"it is no XML at line {error.position[0]}, column {error.position[1]}"
    elif isinstance(error, KeyError):
        text = f"{error.args[0] if error.args else 'a part'} is missing in it, or the reader does not know it"
    elif number:
        text = f"{number[1].strip()} stands where a number is expected"
    elif isinstance(error, INTERNAL) or not text:
        text = "it is damaged, or has parts that the reader does not know"
    return text.rstrip(".") + AGAIN


@contextlib.contextmanager
def _no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _format(path: Path) -> str:
    """The format of the extension; ``.msh`` has two, told apart by their first line."""
    suffix = path.suffix.lower()
    kinds = meshio.extension_to_filetypes.get(suffix, [])
    if not kinds:
        known = ", ".join(sorted(meshio.extension_to_filetypes))
        raise ValueError(f"{path}: cannot be read as a mesh: the extension {suffix!r} is none of {known}")
    if len(kinds) == 1:
        return str(kinds[0])
    with contextlib.suppress(OSError), path.open("rb") as file:
        if file.read(200).lstrip().startswith(b"$"):
            return "gmsh"
    return str(kinds[0])


def _limited(read: Callable[[], meshio.Mesh], seconds: float) -> meshio.Mesh:
    """What ``read`` returns, if it does so in time."""
    if hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread():
        with _alarm(seconds):
            return read()
    return _in_a_thread(read, seconds)


@contextlib.contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def ring(*_: Any) -> None:
        raise _TooLongError

    # time of the processor: on a busy machine a good file may take ten times as long by the clock
    before = signal.signal(signal.SIGPROF, ring)
    timer = signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, *timer)
        signal.signal(signal.SIGPROF, before)


def _in_a_thread(read: Callable[[], meshio.Mesh], seconds: float) -> meshio.Mesh:
    """The same where no signal can interrupt: a reader that hangs is left behind in its thread."""
    result: list[Any] = []

    def work() -> None:
        try:
            result.append((read(), None))
        except BaseException as error:
            result.append((None, error))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(seconds)
    if not result:
        raise _TooLongError
    value, error = result[0]
    if error is not None:
        raise error
    return value


SAME_NODE = 1e-10
"""Nodes closer than this times the size of the mesh are one."""

PLAIN_CELLS = ("triangle", "line", "vertex")


class MeshRepairWarning(UserWarning):
    """A mesh was repaired; the message says how."""


def from_arrays(
    nodes: ArrayLike,
    triangles: ArrayLike,
    boundaries: Mapping[str, Any] | None = None,
    subdomains: Mapping[str, Any] | None = None,
) -> MeshTri:
    """A mesh from ``nodes`` (nodes, 2) and ``triangles`` (elements, 3).

    Parameters
    ----------
    boundaries, subdomains : mappings, optional
        Names of edges, each an (edges, 2) array of node numbers or a predicate of the edge
        midpoints ``x`` (2, edges) of the outer boundary; names of triangles, each an array of
        numbers or a predicate of their midpoints.

    Raises
    ------
    ValueError
        If an array has the wrong shape or a value that is not finite, a triangle has a
        missing or repeated node, no area, or covers another, a node hangs on an edge, or a name is empty.
    """
    p, t = _nodes(nodes), _triangles(triangles, len(np.asarray(nodes)))
    p, t, number = _without_duplicates(p, t)
    used = np.unique(t)
    if used.size < p.shape[1]:
        _warn(f"dropped {p.shape[1] - used.size} nodes that belong to no triangle")
        new = np.full(p.shape[1], -1)
        new[used] = np.arange(used.size)
        p, t, number = p[:, used], new[t], new[number]
    areas = signed_areas(p, t)
    size = float(np.max(np.ptp(p, axis=1)))
    flat = np.flatnonzero(np.abs(areas) <= 1e-14 * size**2)
    if flat.size:
        raise ValueError(f"triangle {flat[0]} has no area")
    if np.any(areas < 0):
        _warn(f"turned {np.sum(areas < 0)} clockwise triangles")
        t = counter_clockwise(p, t)
    mesh = MeshTri(np.ascontiguousarray(p), np.ascontiguousarray(t))
    edge = overlapping(t)
    if edge is not None:
        raise ValueError(f"triangles overlap at the edge between nodes {edge[0]} and {edge[1]}")
    wrong = fault(mesh)
    if wrong is not None:
        raise ValueError(wrong)
    return _named(mesh, boundaries or {}, subdomains or {}, number)


def named(
    mesh: MeshTri,
    boundaries: Mapping[str, Any] | None = None,
    subdomains: Mapping[str, Any] | None = None,
) -> MeshTri:
    """The mesh with further names, given as in :func:`from_arrays`."""
    return _named(mesh, boundaries or {}, subdomains or {}, np.arange(mesh.p.shape[1]))


def read_mesh(path: str | Path) -> MeshTri:
    """A mesh from any file that meshio reads.

    Physical groups of gmsh, sets of cells and reference numbers become names; a group without
    a name is called ``boundary-<number>`` or ``subdomain-<number>``.

    Raises
    ------
    ValueError
        If the file cannot be read, or not in time, has other cells than triangles with straight
        edges (lines and points may come along), or is not plane.
    """
    file = read_file(Path(path))
    if any(key.startswith("skfem:") for key in file.cell_data):
        mesh = MeshTri.load(path)  # scikit-fem's own way to keep names
        edges = {name: mesh.facets[:, facets].T for name, facets in (mesh.boundaries or {}).items()}
        return from_arrays(mesh.p.T, counter_clockwise(mesh.p, mesh.t).T, edges, mesh.subdomains)
    kinds = {block.type: sum(len(b.data) for b in file.cells if b.type == block.type) for block in file.cells}
    other = [kind for kind in kinds if kind not in PLAIN_CELLS]
    if other:
        raise ValueError(
            f"{path}: has {kinds[other[0]]} cells of type {other[0]!r}: only triangles with straight edges "
            "can be used"
        )
    if "triangle" not in kinds:
        raise ValueError(f"{path}: has no triangles{_hint_of_gmsh(file)}")
    points = np.asarray(file.points, dtype=float)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(
            f"{path}: its points have shape {points.shape}: expected two or three coordinates each"
        )
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > SAME_NODE * np.max(np.ptp(points, axis=0)):
        raise ValueError(f"{path}: is not plane: z runs from {points[:, 2].min()} to {points[:, 2].max()}")
    try:
        boundaries, subdomains = _groups(file)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    triangles = np.vstack([block.data for block in file.cells if block.type == "triangle"])
    try:
        return from_arrays(points[:, :2], triangles, boundaries, subdomains)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _hint_of_gmsh(file: meshio.Mesh) -> str:
    """Why a file of gmsh may have lines alone, and how to mend it."""
    if not any(key.startswith("gmsh:") for key in file.cell_data):
        return ""
    return (
        ": gmsh saves only what is in a physical group once there is one; add a physical surface, "
        'Physical Surface("body") = {1}; or gmsh.model.addPhysicalGroup(2, [1], name="body")'
    )


def _nodes(nodes: ArrayLike) -> NDArray[np.float64]:
    p = np.array(nodes, dtype=float)
    if p.ndim != 2 or p.shape[1] != 2:
        raise ValueError(f"nodes must be an array of shape (nodes, 2), got {p.shape}")
    if not np.all(np.isfinite(p)):
        bad = int(np.flatnonzero(~np.all(np.isfinite(p), axis=1))[0])
        raise ValueError(f"node {bad} is at ({p[bad, 0]}, {p[bad, 1]})")
    return p.T


def _triangles(triangles: ArrayLike, n_nodes: int) -> NDArray[np.int64]:
    t = np.array(triangles)
    if t.ndim != 2 or t.shape[1] != 3 or t.shape[0] == 0:
        raise ValueError(f"triangles must be an array of shape (elements, 3), got {t.shape}")
    if not np.issubdtype(t.dtype, np.integer):
        raise ValueError(f"triangles must hold node numbers, got values of type {t.dtype}")
    if t.min() < 0 or t.max() >= n_nodes:
        bad = int(np.flatnonzero(np.any((t < 0) | (t >= n_nodes), axis=1))[0])
        raise ValueError(f"triangle {bad} has nodes {t[bad].tolist()}, but nodes run from 0 to {n_nodes - 1}")
    return t.astype(np.int64).T


def _without_duplicates(p: NDArray, t: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Nodes at one place merged; also the new number of each old node."""
    pairs = cKDTree(p.T).query_pairs(SAME_NODE * float(np.max(np.ptp(p, axis=1))), output_type="ndarray")
    number = np.arange(p.shape[1])
    for a, b in pairs[np.argsort(pairs[:, 1])]:
        number[b] = number[a]
    merged = np.unique(number)
    if merged.size < p.shape[1]:
        used = np.isin(np.flatnonzero(number != np.arange(number.size)), t)
        if np.any(used):
            _warn(f"merged {p.shape[1] - merged.size} duplicate nodes")
        number = np.searchsorted(merged, number)
        p, t = p[:, merged], number[t]
    repeated = np.flatnonzero((t[0] == t[1]) | (t[1] == t[2]) | (t[0] == t[2]))
    if repeated.size:
        raise ValueError(f"triangle {repeated[0]} has a repeated node")
    return p, t, number


def _named(
    mesh: MeshTri, boundaries: Mapping[str, Any], subdomains: Mapping[str, Any], number: NDArray
) -> MeshTri:
    lookup = {tuple(pair): facet for facet, pair in enumerate(np.sort(mesh.facets, axis=0).T.tolist())}
    facets, elements = {}, {}
    for name, value in boundaries.items():
        if callable(value):
            facets[name] = _chosen(mesh.p[:, mesh.facets].mean(axis=1), value, mesh.boundary_facets())
        else:
            facets[name] = _facet_numbers(name, np.asarray(value), lookup, number)
    for name, value in subdomains.items():
        if callable(value):
            elements[name] = _chosen(mesh.p[:, mesh.t].mean(axis=1), value, np.arange(mesh.t.shape[1]))
        else:
            elements[name] = np.unique(np.asarray(value, dtype=np.int64))
            if np.any((elements[name] < 0) | (elements[name] >= mesh.t.shape[1])):
                raise ValueError(f"the subdomain {name!r} has a triangle that the mesh has not")
    for kind, names in (("boundary", facets), ("subdomain", elements)):
        for name, value in names.items():
            if np.size(value) == 0:
                raise ValueError(f"the {kind} {name!r} is empty")
    # with_boundaries would drop empty ones silently
    mesh = mesh.with_boundaries({**(mesh.boundaries or {}), **facets}) if facets else mesh
    return mesh.with_subdomains({**(mesh.subdomains or {}), **elements}) if elements else mesh


def _chosen(midpoints: NDArray, predicate: Callable[[Any], Any], among: NDArray) -> NDArray[np.int64]:
    inside = np.broadcast_to(np.asarray(predicate(midpoints[:, among]), dtype=bool), among.shape)
    return np.asarray(among[inside], dtype=np.int64)


def _facet_numbers(name: str, edges: NDArray, lookup: dict, number: NDArray) -> NDArray[np.int64]:
    if edges.size and (edges.ndim != 2 or edges.shape[1] != 2):
        raise ValueError(f"the boundary {name!r} must be an array of shape (edges, 2), got {edges.shape}")
    result = []
    for a, b in edges.reshape(-1, 2):
        facet = lookup.get((min(number[a], number[b]), max(number[a], number[b])))
        if facet is None:
            raise ValueError(f"the boundary {name!r} has the edge ({a}, {b}), which is no edge of a triangle")
        result.append(facet)
    return np.unique(np.array(result, dtype=np.int64))


def _groups(file: meshio.Mesh) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
    """Named edges and triangles of a meshio mesh."""
    parts: dict[str, dict[str, list[NDArray]]] = {"line": {}, "triangle": {}}
    title = {"line": "boundary", "triangle": "subdomain"}
    dimension = {"line": 1, "triangle": 2}
    names = {(int(i), int(dim)): name for name, (i, dim) in (file.field_data or {}).items()}
    offset = 0
    for position, block in enumerate(file.cells):
        if block.type not in parts:
            continue
        count = len(block.data)
        cells = np.asarray(block.data) if block.type == "line" else offset + np.arange(count)
        offset += count if block.type == "triangle" else 0
        for key in ("gmsh:physical", "medit:ref"):
            tags = np.asarray(file.cell_data[key][position]) if key in file.cell_data else np.zeros(count)
            for tag in np.unique(tags[tags > 0]).astype(int):
                name = names.get((tag, dimension[block.type]), f"{title[block.type]}-{tag}")
                parts[block.type].setdefault(name, []).append(cells[tags == tag])
        for name, chosen in (file.cell_sets or {}).items():
            # gmsh's own sets repeat its physical groups; the others are none of the user's
            if str(name).startswith("gmsh:") or name in parts[block.type]:
                continue
            members = _members(name, chosen, position)
            if members.size:
                parts[block.type].setdefault(name, []).append(cells[members])
    return tuple({n: np.concatenate(v) for n, v in parts[k].items()} for k in ("line", "triangle"))  # type: ignore[return-value]


def _members(name: Any, chosen: Any, position: int) -> NDArray[np.int64]:
    """Numbers of the cells of a set in one block."""
    try:
        members = np.asarray([] if chosen[position] is None else chosen[position], dtype=np.int64)
        if members.ndim == 1:
            return members
    except (IndexError, TypeError, ValueError):
        pass
    raise ValueError(
        f"the set {name!r} is no list of cells, perhaps one of sets: write out its cells, or leave it out"
    )


def _warn(message: str) -> None:
    warnings.warn(message, MeshRepairWarning, stacklevel=4)
