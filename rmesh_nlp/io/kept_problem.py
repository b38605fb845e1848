"""The problem file of a solve, kept beside its solution."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.io.problem_schema import ProblemTable

PROBLEM = "problem.toml"
MESH = "given-mesh"  # name, without its ending, of the copy of the mesh file


def names(table: ProblemTable) -> dict[str, Path]:
    """What is kept of a problem file, by name what it is a copy of: the problem, and its mesh file."""
    path, mesh = table.source.path, table.mesh.file
    return {PROBLEM: path} | ({} if mesh is None else {MESH + Path(mesh).suffix: path.parent / mesh})


def keep(copies: Mapping[str, Path], folder: Path) -> None:
    """Copy files into a folder, by their names there."""
    for name, source in copies.items():
        write_whole(folder / name, partial(shutil.copyfile, source))
