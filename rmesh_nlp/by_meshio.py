"""Files read by meshio or gmsh, in a process of its own: some readers find no end of a damaged file.

It is no part of ``meshes``, whose imports would double the time that the process takes to start.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import meshio
import numpy as np

from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.optimize.process import Process, packed, serve, unpacked

SECONDS, MEGABYTES = 30.0, 4000.0
"""Limits of a reader, which takes about 1 s and 100 MB for 1e5 triangles."""

UNREAD = re.compile(
    r"^(?:C(?:TRI(?!A[36R])|QUA(?!D[48R])|TRAX|PLST)\w*"
    r"|(?:GRID    |GRDSET  ).{8}.{0,7}[1-9]|GRID\* {3}.{16}.{0,15}[1-9]|GR\w*\*?,[^,]*,[^,]*[1-9])",
    re.M,
)
"""Elements of Nastran that meshio passes over, and nodes in a coordinate system of their own."""

BEYOND = re.compile(
    r"^(CTRIA[3R] .{41}|CTRIA[3R](?:,[^,\n]*){5}|CQUAD[4R] .{49}|CQUAD[4R](?:,[^,\n]*){6}).*", re.M
)
"""Elements of Nastran with what follows their nodes."""

_meshio = Process("rmesh_nlp.by_meshio")


def read_file(path: Path, kind: str) -> meshio.Mesh | bytes:
    """What meshio reads of a file in one format, or of MED and UNV the file .msh that gmsh makes of it.

    Raises
    ------
    ValueError
        If it cannot be read within the limits.
    """
    answer = _meshio.ask(packed((path.absolute(), kind)), SECONDS, MEGABYTES)
    made = answer.why if answer.line is None else unpacked(answer.line)
    if isinstance(made, str):
        raise BadInputError(
            f"{path}: cannot be read as a mesh of the format {kind} ({made}): if it is not damaged, "
            "write it as .msh of gmsh or .vtu"
        )
    return made


def _read(line: bytes) -> bytes:
    """The mesh, or one line for people on why there is none."""
    path, kind = unpacked(line)
    try:
        with TemporaryDirectory() as folder:
            made = (_by_gmsh if kind in ("med", "unv") else _by_meshio)(path, kind, Path(folder, "copy.msh"))
    except Exception as error:  # meshio's readers and gmsh raise anything
        made = f"{type(error).__name__}: {one_line(error)}"
    return packed(made)


def _by_meshio(path: Path, kind: str, copy: Path) -> meshio.Mesh:
    """The mesh; markers of SU2, of which meshio keeps numbers, are its sets.

    meshio wants the first line of the copy before bulk data of Nastran, which often stand alone, and nothing
    after the nodes of its elements. It fails at the last line where a section of SU2 ends early.
    """
    markers = dict[str, int]()
    if kind in ("nastran", "su2"):
        text = path.read_text("utf-8", "replace")
        if kind == "su2":  # slow where columns are filled with blanks
            text = re.sub(
                "(?<=MARKER_TAG=).*",
                lambda tag: f"{markers.setdefault(tag[0].strip(), len(markers) + 1)}",
                re.sub(r"%.*|[ \t]*(=)[ \t]*", r"\1", text),
            )
        elif said := UNREAD.search(text):
            raise BadInputError(f"{said[0]}: write CTRIA3 or CQUAD4, and GRID in the global system")
        elif "\nENDDATA" not in text:
            raise BadInputError("it has no line ENDDATA: add one at the end if it is whole")
        else:
            text = BEYOND.sub(r"\1", text)
        copy.write_text(f"BEGIN BULK\n{text}\nEND=\n", "utf-8")
        path = copy
    made = getattr(meshio, kind.partition("-")[0]).read(path)
    for name, number in markers.items():
        made.cell_sets[name] = [np.flatnonzero(tags == number) for tags in made.cell_data["su2:tag"]]
    return made


def _by_gmsh(path: Path, kind: str, copy: Path) -> bytes:
    """The content of the file that gmsh writes of it; sections of UNV begin and end with -1."""
    if kind == "unv" and sum(line.strip() == b"-1" for line in path.read_bytes().splitlines()) % 2:
        raise BadInputError("it ends within a section")
    gmsh = import_module("gmsh")
    gmsh.initialize(["gmsh", "-v", "0", "-save_all"], interruptible=False)
    gmsh.open(str(path))
    gmsh.write(str(copy))
    gmsh.finalize()
    return copy.read_bytes()


if __name__ == "__main__":
    serve(_read)
