"""Meshes from files of gmsh, Abaqus and CalculiX, or of any format of meshio, with their groups as names."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri
from skfem.io.meshio import from_meshio

from rmesh_nlp.by_meshio import read_file
from rmesh_nlp.errors import BadInputError, expect_path, located, unknown
from rmesh_nlp.meshes.abaqus import read_inp
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.file_mesh import TITLES, USABLE, Block, FileMesh, positions, triangulated
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.msh import read_msh

FORMATS = {suffix: kinds[-1] for suffix, kinds in meshio.extension_to_filetypes.items()} | {".unv": "unv"}
"""Formats by suffixes; of the two of ``.msh`` that of gmsh."""


def _format(path: Path) -> str:
    """The format of the extension of a file with content."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise BadInputError(f"{path}: cannot be read as a mesh: {unknown('extension', suffix, FORMATS)}")
    if not path.is_file() or not path.stat().st_size:
        said = "it is empty: write it again" if path.is_file() else "there is no such file"
        raise BadInputError(f"{path}: cannot be read as a mesh: {said}")
    return FORMATS[suffix]


CORNERS = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4}
"""Corners of the kinds of cells of meshio that can be used, whose names may end with a number of nodes."""

REFERENCES = {
    "avsucd:material",
    "gmsh:physical",
    "medit:ref",
    "nastran:ref",
    "netgen:index",
    "tetgen:ref",
}
"""What meshio calls numbers of groups of cells."""


def read_mesh(path: str | Path, pairs: Collection[tuple[str, str]] = ()) -> MeshTri:
    """A mesh from a file of gmsh, Abaqus or CalculiX, or any other that meshio reads.

    Physical groups, sets of elements, surfaces and reference numbers become names; a set of nodes (``*NSET``)
    names the outer edges between them. A group without a name is called ``boundary-<number>``
    or ``subdomain-<number>``. Quadrilaterals are cut into triangles, of higher orders the corners are taken,
    other planes turned into the x-y plane; a :class:`MeshRepairWarning` says so. Nodes at one place are
    merged, but for those of two boundaries of ``pairs``.

    Raises
    ------
    ValueError
        If the file cannot be read, has other cells than points, lines, triangles and quadrilaterals, or is
        not plane.
    """
    expect_path(path)
    path = Path(path)
    kind = _format(path)
    data = path.read_bytes() if kind == "gmsh" and b'"skfem:' not in path.read_bytes() else b""
    if kind == "abaqus" or b"$MeshFormat" in data or b"$NOD" in data:
        with located(f"{path}: cannot be read", (ValueError, TypeError, LookupError, ArithmeticError)):
            file = read_msh(data) if data else read_inp(path)
    else:
        read = read_file(path, "ansys" if data else kind)  # the other format of files .msh, of Fluent
        file = read_msh(read) if isinstance(read, bytes) else read
        if isinstance(file, meshio.Mesh) and any(key.startswith("skfem:") for key in file.cell_data):
            mesh = from_meshio(file)  # scikit-fem's own way to keep names
            edges = {name: mesh.facets[:, facets].T for name, facets in (mesh.boundaries or {}).items()}
            return from_arrays(mesh.p.T, counter_clockwise(mesh.p, mesh.t).T, edges, mesh.subdomains, pairs)
    with located(path):
        return triangulated(file if isinstance(file, FileMesh) else _of_meshio(file), pairs)


def _of_meshio(file: meshio.Mesh) -> FileMesh:
    """What meshio read; groups without names are called by their numbers."""
    blocks, index = list[Block](), positions(np.arange(len(file.points)))
    for position, block in enumerate(file.cells):
        corners, groups = CORNERS.get(block.type.rstrip("0123456789"), 0), dict[str, NDArray]()
        if not corners:
            raise BadInputError(f"has cells of type {block.type!r}: {USABLE}")
        for key in REFERENCES & file.cell_data.keys():
            tags = file.cell_data[key][position]
            for tag in np.unique(tags[tags > 0]).tolist():
                groups[f"{TITLES[min(corners, 3) - 1]}-{tag}"] = np.flatnonzero(tags == tag)
        for name, chosen in file.cell_sets.items():
            if chosen[position] is not None and len(chosen[position]):
                groups[name] = np.asarray(chosen[position])
        blocks.append(Block(corners, index(block.data), groups))
    return FileMesh(file.points, blocks, file.point_sets)
