"""Meshes from files of gmsh, Abaqus and CalculiX, or of any format of meshio, with their groups as names."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError, expect_path, located, one_line
from rmesh_nlp.meshes.abaqus import read_inp
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.file_mesh import TITLES, USABLE, Block, FileMesh, triangulated
from rmesh_nlp.meshes.geometry import counter_clockwise
from rmesh_nlp.meshes.msh import physical_names, read_msh

FORMATS = {suffix: kinds[-1] for suffix, kinds in meshio.extension_to_filetypes.items()}
"""Formats by suffixes; of the two of ``.msh`` that of gmsh, since meshio loses the zones of the other."""

ENDLESS = (".off", ".ply")
"""Suffixes of surfaces without names, of which meshio's readers find no end in a damaged file."""


def read_file(path: Path, kind: str) -> meshio.Mesh:
    """The mesh of a file, read by meshio in a format and no other.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    quiet = io.StringIO()  # meshio prints what it dislikes
    try:
        with (
            contextlib.redirect_stdout(quiet),
            contextlib.redirect_stderr(quiet),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            return meshio.read(path, kind)
    except (SystemExit, Exception) as error:  # meshio's readers raise anything, some call sys.exit
        raise BadInputError(
            f"{path}: cannot be read as a mesh of the format {kind}: {_reason(error, kind)}"
        ) from error


def _reason(error: BaseException, kind: str) -> str:
    """One line for people on why a reader of meshio gave up, and what to do."""
    if isinstance(error, ModuleNotFoundError):
        return f"this format needs the package {error.name}: pip install {error.name}"
    again = (
        "with gmsh OLD.msh -save -format msh41 -o NEW.msh" if kind == "gmsh" else "as .msh of gmsh or .vtu"
    )
    said = f"{type(error).__name__}: {one_line(error)}"
    return f"it is damaged or of an unknown version ({said}); write it again {again}"


def _format(path: Path) -> str:
    """The format of the extension of a file with content."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS or suffix in ENDLESS:
        choices = ", ".join(sorted({*FORMATS} - {*ENDLESS}))
        raise BadInputError(
            f"{path}: cannot be read as a mesh: the extension {suffix!r} is none of {choices}"
        )
    if not path.is_file() or not path.stat().st_size:
        said = "it is empty: write it again" if path.is_file() else "there is no such file"
        raise BadInputError(f"{path}: cannot be read as a mesh: {said}")
    return FORMATS[suffix]


CORNERS = {
    "vertex": 1,
    "line": 2,
    "line3": 2,
    "triangle": 3,
    "triangle6": 3,
    "quad": 4,
    "quad8": 4,
    "quad9": 4,
}
"""Kinds of cells of meshio that can be used, and their corners."""


def read_mesh(path: str | Path, pairs: Collection[tuple[str, str]] = ()) -> MeshTri:
    """A mesh from a file of gmsh, Abaqus or CalculiX, or any other that meshio reads.

    Physical groups, sets of elements, surfaces and reference numbers become names; a set of nodes (``*NSET``)
    names the outer edges between them. A group without a name is called ``boundary-<number>``
    or ``subdomain-<number>``. Quadrilaterals are cut into triangles, nodes between corners dropped, other
    planes turned into the x-y plane; a :class:`MeshRepairWarning` says so. Nodes at one place are merged, but
    for those of two boundaries of ``pairs``.

    Raises
    ------
    ValueError
        If the file cannot be read, has other cells than points, lines, triangles and
        quadrilaterals of order 1 or 2, or is not plane.
    """
    expect_path(path)
    path = Path(path)
    kind = _format(path)
    data = path.read_bytes() if kind == "gmsh" else b""
    with located(path):
        if kind == "abaqus":
            return triangulated(read_inp(path), pairs)
        if data.split(maxsplit=2)[1:2] == [b"4.1"]:
            return triangulated(read_msh(data), pairs)
    file = read_file(path, kind)
    if any(key.startswith("skfem:") for key in file.cell_data):
        mesh = MeshTri.load(path)  # scikit-fem's own way to keep names
        edges = {name: mesh.facets[:, facets].T for name, facets in (mesh.boundaries or {}).items()}
        return from_arrays(mesh.p.T, counter_clockwise(mesh.p, mesh.t).T, edges, mesh.subdomains, pairs)
    with located(path):
        return triangulated(_of_meshio(file, physical_names(data)), pairs)


def _of_meshio(file: meshio.Mesh, names: Mapping[tuple[int, int], str]) -> FileMesh:
    """What meshio read; ``names`` of physical groups by dimension and number, which it may have lost."""
    blocks = list[Block]()
    for position, block in enumerate(file.cells):
        if block.type not in CORNERS:
            raise BadInputError(f"has cells of type {block.type!r}: {USABLE}")
        dimension, groups = min(CORNERS[block.type], 3) - 1, dict[str, NDArray]()
        for key in {"gmsh:physical", "medit:ref"} & {*file.cell_data}:
            tags = file.cell_data[key][position]
            for tag in np.unique(tags[tags > 0]).tolist():
                groups[names.get((dimension, tag), f"{TITLES[dimension]}-{tag}")] = np.flatnonzero(
                    tags == tag
                )
        families = getattr(file, "cell_tags", {})  # of MED: names by number, a name may be in several
        for name in {name for own in families.values() for name in own}:
            of_name = [number for number, own in families.items() if name in own]
            members = np.flatnonzero(np.isin(file.cell_data["cell_tags"][position], of_name))
            groups |= {name: members} if members.size else {}
        for name, chosen in file.cell_sets.items():
            if chosen[position] is not None and len(chosen[position]):
                groups[name] = np.asarray(chosen[position])
        blocks.append(Block(CORNERS[block.type], block.data, groups))
    return FileMesh(file.points, blocks, file.point_sets, names.values())
