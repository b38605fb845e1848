"""Meshes from any file that meshio reads, with their groups as names."""

from __future__ import annotations

import contextlib
import io
import re
import signal
import threading
import warnings
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError, expect_path, located, one_line
from rmesh_nlp.evaluation import ROUNDING, Index
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.geometry import counter_clockwise, sides
from rmesh_nlp.meshes.groups import check_groups

SECONDS, SECONDS_PER_BYTE = 10.0, 2e-6
"""Longest time of the processor to read a file: meshio takes about 2e-7 seconds per byte of text."""


class _TooLongError(Exception):
    pass


def read_file(path: Path) -> meshio.Mesh:
    """The mesh of a file, read in the format of its extension and no other.

    Some of meshio's readers never come to the end of a damaged file, so their time is limited where a signal
    can interrupt them: in the main thread, and not on Windows.

    Raises
    ------
    ValueError
        If it cannot be read, or takes too long.
    """
    kind = _format(path)
    if not path.is_file():
        raise BadInputError(f"{path}: cannot be read as a mesh: there is no such file")
    size = path.stat().st_size
    if size == 0:
        raise BadInputError(f"{path}: cannot be read as a mesh: it is empty{AGAIN}")
    seconds = SECONDS + SECONDS_PER_BYTE * size
    said = io.StringIO()  # meshio prints what it dislikes
    try:
        quiet = contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO())
        with quiet[0], quiet[1], warnings.catch_warnings(), _limited(seconds):
            warnings.simplefilter("ignore")
            file = meshio.read(path, kind)
    except _TooLongError:
        raise BadInputError(
            f"{path}: cannot be read as a mesh: the reader of {kind} found no end within {seconds:.0f} s; "
            "the file may be damaged"
        ) from None
    except (SystemExit, Exception) as error:  # meshio's readers raise anything, some call sys.exit
        reason = _reason(error, said.getvalue())
        raise BadInputError(f"{path}: cannot be read as a mesh of the format {kind}: {reason}") from error
    with located(path):
        check_groups(kind, path)
    return file


AGAIN = "; export it again, as .msh of gmsh or .vtu if it can be"

INTERNAL = (AssertionError, AttributeError, IndexError, TypeError, NameError)
"""Errors of a reader that met what it was not made for; their texts speak of its code."""


def _reason(error: BaseException, said: str) -> str:
    """One line for people on why a reader of meshio gave up, and what to do."""
    if isinstance(error, ModuleNotFoundError):
        return f"this format needs the package {error.name}: pip install {error.name}"
    text = one_line(error)
    if isinstance(error, SystemExit):  # its reason was printed
        lines = [line for line in said.splitlines() if re.match(r"\s*[A-Za-z]", line)]
        text = lines[-1].strip() if lines else "its content is in another format"
    elif isinstance(error, KeyError):
        text = f"{error.args[0] if error.args else 'a part'} is missing in it, or the reader does not know it"
    elif isinstance(error, INTERNAL) or not text:
        text = "it is damaged, or has parts that the reader does not know"
    return text.rstrip(".") + AGAIN


def _format(path: Path) -> str:
    """The format of the extension; ``.msh`` has two, told apart by their first line."""
    suffix = path.suffix.lower()
    kinds = meshio.extension_to_filetypes.get(suffix, [])
    if not kinds:
        choices = ", ".join(sorted(meshio.extension_to_filetypes))
        raise BadInputError(
            f"{path}: cannot be read as a mesh: the extension {suffix!r} is none of {choices}"
        )
    if len(kinds) == 1:
        return str(kinds[0])
    with contextlib.suppress(OSError), path.open("rb") as file:
        if file.read(200).lstrip().startswith(b"$"):
            return "gmsh"
    return str(kinds[0])


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raise a _TooLongError after these seconds, where signals can."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

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


PLAIN_CELLS = ("triangle", "line", "vertex")


def read_mesh(path: str | Path, pairs: Collection[tuple[str, str]] = ()) -> MeshTri:
    """A mesh from any file that meshio reads.

    Physical groups of gmsh, sets of cells and reference numbers become names; a set of nodes (``*NSET``)
    names the outer edges between them. A group without a name is called ``boundary-<number>`` or
    ``subdomain-<number>``. Nodes at one place are merged, but for those of two boundaries of ``pairs``.

    Raises
    ------
    ValueError
        If the file cannot be read, or not in time, has other cells than triangles with straight
        edges (lines and points may come along), or is not plane.
    """
    expect_path(path)
    file = read_file(Path(path))
    if any(key.startswith("skfem:") for key in file.cell_data):
        mesh = MeshTri.load(path)  # scikit-fem's own way to keep names
        edges = {name: mesh.facets[:, facets].T for name, facets in (mesh.boundaries or {}).items()}
        return from_arrays(mesh.p.T, counter_clockwise(mesh.p, mesh.t).T, edges, mesh.subdomains, pairs)
    with located(path):
        return _mesh(file, pairs)


def _mesh(file: meshio.Mesh, pairs: Collection[tuple[str, str]]) -> MeshTri:
    kinds = [block.type for block in file.cells]
    for kind in kinds:
        if kind not in PLAIN_CELLS:
            count = sum(len(block.data) for block in file.cells if block.type == kind)
            raise BadInputError(
                f"has {count} cells of type {kind!r}: only triangles with straight edges can be used"
            )
    if "triangle" not in kinds:
        # gmsh may have left them out
        made_by_gmsh = any(key.startswith("gmsh:") for key in file.cell_data)
        raise BadInputError(f"has no triangles{HINT_OF_GMSH if made_by_gmsh else ''}")
    points = np.asarray(file.points, dtype=float)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise BadInputError(f"its points have shape {points.shape}: expected two or three coordinates each")
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > ROUNDING * np.max(np.ptp(points, axis=0)):
        raise BadInputError(f"is not plane: z runs from {points[:, 2].min()} to {points[:, 2].max()}")
    groups = _groups(file)
    triangles = np.vstack([block.data for block in file.cells if block.type == "triangle"])
    between = _outer_edges(triangles, file.point_sets or {})
    return from_arrays(points[:, :2], triangles, between | groups["line"], groups["triangle"], pairs)


def _outer_edges(triangles: NDArray, sets: Mapping[str, Any]) -> dict[str, NDArray]:
    """The outer edges between the nodes of each set, as pairs of nodes; sets without any are left out."""
    edges = np.sort(sides(triangles.T).T, axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    outer = edges[counts == 1]
    named = {name: outer[np.all(np.isin(outer, nodes), axis=1)] for name, nodes in sets.items()}
    return {name: edges for name, edges in named.items() if len(edges)}


HINT_OF_GMSH = (
    ": gmsh saves only what is in a physical group once there is one; add a physical surface, "
    'Physical Surface("body") = {1}; or gmsh.model.addPhysicalGroup(2, [1], name="body")'
)

GROUPS = {"line": (1, "boundary"), "triangle": (2, "subdomain")}
"""Dimension of the groups of cells of one kind, and what they are called without a name."""


def _groups(file: meshio.Mesh) -> dict[str, dict[str, NDArray]]:
    """Named edges ("line"), as pairs of nodes, and named triangles by their numbers."""
    parts: dict[str, dict[str, list[NDArray]]] = {kind: {} for kind in GROUPS}
    names = {(int(i), int(dim)): name for name, (i, dim) in (file.field_data or {}).items()}
    offset = 0
    for position, block in enumerate(file.cells):
        if block.type not in GROUPS:
            continue
        (dimension, title), part, count = GROUPS[block.type], parts[block.type], len(block.data)
        cells = np.asarray(block.data) if block.type == "line" else offset + np.arange(count)
        offset += count if block.type == "triangle" else 0
        for key in ("gmsh:physical", "medit:ref"):
            tags = np.asarray(file.cell_data[key][position]) if key in file.cell_data else np.zeros(count)
            for tag in np.unique(tags[tags > 0]).astype(int):
                name = names.get((tag, dimension), f"{title}-{tag}")
                part.setdefault(name, []).append(cells[tags == tag])
        for name, chosen in (file.cell_sets or {}).items():
            if str(name).startswith("gmsh:"):  # none of the user's
                continue
            members = _members(name, chosen, position)
            if members.size:
                part.setdefault(name, []).append(cells[members])
    # a set of gmsh is a physical group again, complete where an entity is in several
    return {
        kind: {name: np.unique(np.concatenate(arrays), axis=0) for name, arrays in parts[kind].items()}
        for kind in parts
    }


def _members(name: Any, chosen: Any, position: int) -> Index:
    """Numbers of the cells of a set in one block."""
    try:
        members = np.asarray([] if chosen[position] is None else chosen[position], dtype=np.int64)
        if members.ndim == 1:
            return members
    except (IndexError, TypeError, ValueError):
        pass
    raise BadInputError(
        f"the set {name!r} is no list of cells, perhaps one of sets: write out its cells, or leave it out"
    )
