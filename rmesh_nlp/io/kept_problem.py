"""The problem file of a solve, kept beside its solution."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.io.problem_schema import ProblemTable

PROBLEM = "problem.toml"
MESH = "given-mesh"  # name, without its ending, of the copy of the mesh file


def names(table: ProblemTable) -> dict[str, Path]:
    """The files that :func:`keep` writes, by name what they are copies of: the problem, and its mesh file."""
    path, mesh = table.source.path, table.mesh.file
    return {PROBLEM: path} | ({} if mesh is None else {MESH + Path(mesh).suffix: path.parent / mesh})


def keep(table: ProblemTable, folder: Path) -> None:
    """Copy a problem file, and the mesh file that it names, into a folder."""
    for name, source in names(table).items():
        write_whole(folder / name, partial(shutil.copyfile, source))
