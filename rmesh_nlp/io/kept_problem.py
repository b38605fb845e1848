"""The problem file of a solve, kept beside its solution so that figures can be drawn again."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from skfem import MeshTri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.files import write_whole
from rmesh_nlp.io.problem_file import build, read_table
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.residual import Multipliers
from rmesh_nlp.problem import ContactProblem

PROBLEM = "problem.toml"
MESH = "given-mesh"  # name, without its ending, of the copy of the mesh file


@dataclass(frozen=True)
class KeptSolution:
    """What figures of a relocation need, read back from a folder; ``mesh`` is the relocated one."""

    problem: ContactProblem
    mesh: MeshTri
    displacement: Array
    pressure: Array
    multipliers: Multipliers | None


def names(table: ProblemTable) -> list[str]:
    """The files that :func:`keep` writes: the problem and the mesh file that it names."""
    return [PROBLEM] if table.mesh.file is None else [PROBLEM, MESH + Path(table.mesh.file).suffix]


def keep(path: Path, table: ProblemTable, folder: Path) -> None:
    """Copy a problem file, and the mesh file that it names, into a folder."""
    sources = [path, path.parent / (table.mesh.file or "")]
    for source, name in zip(sources, names(table), strict=False):
        write_whole(folder / name, partial(shutil.copyfile, source))


def read_kept(folder: Path, record: Record) -> KeptSolution | None:
    """The solution of a folder that ``rmesh solve my.toml`` wrote.

    None if no problem file is kept there, or the solution is one on another mesh: remeshed, of
    refined elements.
    """
    path = folder / PROBLEM
    if not path.exists():
        return None
    table = read_table(path)
    if table.mesh.file is not None:
        mesh_table = table.mesh.model_copy(update={"file": names(table)[1]})
        table = table.model_copy(update={"mesh": mesh_table})
    problem = build(table, path)
    if record.get("quadrature") is not None:  # some formulations raise it
        problem = replace(problem, quadrature=record["quadrature"])
    fields = read_vtu(folder / "solution.vtu")
    space = DisplacementSpace.of(problem)
    if not np.array_equal(fields.triangles, space.elements):
        return None
    vertices, multipliers = space.nodes_of(np.arange(problem.mesh.p.shape[1])), fields.multipliers
    if multipliers is not None:
        multipliers = replace(multipliers, limit=multipliers.limit[vertices])
    mesh = relocated_mesh(problem.mesh, fields.nodes[:, vertices])
    return KeptSolution(problem, mesh, fields.displacement, fields.pressure, multipliers)
