"""Files read by meshio, in a process of its own: some readers find no end of a damaged file, or of memory."""

from __future__ import annotations

from pathlib import Path

import meshio

from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.optimize.process import Process, packed, serve, unpacked

SECONDS, MEGABYTES = 30.0, 4000.0
"""Limits of a reader, which takes about 1 s and 100 MB for 1e5 triangles."""

_meshio = Process("rmesh_nlp.meshes.by_meshio")


def read_file(path: Path, kind: str) -> meshio.Mesh:
    """The mesh of a file, read in a format and no other.

    Raises
    ------
    ValueError
        If it cannot be read within the limits.
    """
    answer = _meshio.ask(packed((path.absolute(), kind)), None, SECONDS, MEGABYTES)
    made = answer.why if answer.line is None else unpacked(answer.line)
    if isinstance(made, str):
        raise BadInputError(
            f"{path}: cannot be read as a mesh of the format {kind} ({made}): if it is not damaged, "
            "write it as .msh of gmsh or .vtu"
        )
    return made


def _read(line: bytes) -> bytes:
    """The mesh, or one line for people on why there is none."""
    try:
        made = meshio.read(*unpacked(line))
    except (SystemExit, Exception) as error:  # meshio's readers raise anything, some call sys.exit
        made = f"{type(error).__name__}: {one_line(error)}"
    return packed(made)


if __name__ == "__main__":
    serve(_read)
