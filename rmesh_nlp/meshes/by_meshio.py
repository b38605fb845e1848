"""Files read by meshio, in a process of its own: some readers find no end of a damaged file, or of memory."""

from __future__ import annotations

import pickle
from base64 import b64decode, b64encode
from pathlib import Path

import meshio

from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.optimize.process import Process, serve

SECONDS, MEGABYTES = (20.0, 1e-5), (1000.0, 2e-4)
"""Limits of a reader: of any file, and more per byte; ten times what it needs and more."""

_meshio = Process("rmesh_nlp.meshes.by_meshio")


def read_file(path: Path, kind: str) -> meshio.Mesh:
    """The mesh of a file, read in a format and no other.

    Raises
    ------
    ValueError
        If it cannot be read within the limits.
    """
    size = path.stat().st_size
    limits = (least + more * size for least, more in (SECONDS, MEGABYTES))
    answer = _meshio.ask(b64encode(pickle.dumps((str(path.absolute()), kind))), None, *limits)
    if answer.line is None:
        made = _again(f"its reader was ended: {answer.why.replace('_', ' ')}")
    else:
        made = pickle.loads(b64decode(answer.line))
    if isinstance(made, str):
        raise BadInputError(f"{path}: cannot be read as a mesh of the format {kind}: {made}")
    return made


def _again(said: str) -> str:
    return f"it is damaged or of an unknown version ({said}); write it again as .msh of gmsh or .vtu"


def _read(line: bytes) -> bytes:
    """The mesh, or one line for people on why there is none."""
    try:
        made = meshio.read(*pickle.loads(b64decode(line)))
    except ModuleNotFoundError as error:
        made = f"this format needs the package {error.name}: pip install {error.name}"
    except (SystemExit, Exception) as error:  # meshio's readers raise anything, some call sys.exit
        made = _again(f"{type(error).__name__}: {one_line(error)}")
    return b64encode(pickle.dumps(made))


if __name__ == "__main__":
    serve(_read)
