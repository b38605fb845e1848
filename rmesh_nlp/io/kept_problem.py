"""The problem file of a solve, kept beside its solution so that figures can be drawn again."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from skfem import MeshTri

from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.io.problem_builder import build
from rmesh_nlp.io.problem_file import read_table
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import single_result
from rmesh_nlp.io.vtu import Fields, read_vtu
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.models.residual import Multipliers
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import on_mesh

PROBLEM = "problem.toml"
WRITTEN = "mesh.msh"  # the relocated mesh
MESH = "given-mesh"  # name, without its ending, of the copy of the mesh file


@dataclass(frozen=True)
class KeptSolution:
    """What figures of a relocation need, read back from a folder; ``mesh`` is the relocated one.

    Displacement (components, nodes) and pressure (nodes,) are values at the points of the nodes, as in files.

    ``is_remeshed`` says that the mesh before relocation is not the given one. ``designed`` is the problem
    with its design variables, if it has any; ``problem`` has their numbers. ``history`` are the steps.
    """

    problem: ContactProblem
    mesh: MeshTri
    displacement: Array
    pressure: Array
    multipliers: Multipliers | None
    is_remeshed: bool
    designed: ContactProblem | None
    objective: str
    history: Sequence[Mapping[str, Any]]


def names(table: ProblemTable) -> dict[str, Path]:
    """The files that :func:`keep` writes, by name what they are copies of: the problem, and its mesh file."""
    path, mesh = table.source.path, table.mesh.file
    return {PROBLEM: path} | ({} if mesh is None else {MESH + Path(mesh).suffix: path.parent / mesh})


def keep(table: ProblemTable, folder: Path) -> None:
    """Copy a problem file, and the mesh file that it names, into a folder."""
    for name, source in names(table).items():
        write_whole(folder / name, partial(shutil.copyfile, source))


def read_kept(folder: Path, record: Record) -> KeptSolution | None:
    """The solution of a folder that ``rmesh solve my.toml`` wrote.

    None if no problem file is kept there, or the solution is one on another mesh that cannot be read back.
    """
    path = folder / PROBLEM
    if not path.exists():
        return None
    table = read_table(path)
    if table.mesh.file is not None:
        *_, copy = names(table)
        table = table.model_copy(update={"mesh": table.mesh.model_copy(update={"file": copy})})
    # the command line may have given another order, and some formulations raise the degree of the rule
    problem, rule = build(table, record.get("order")), record.get("quadrature")
    problem = problem if rule is None else problem.with_rule(rule)
    designed = problem if problem.design else None
    problem = problem.at_design(record.get("design"))
    fields = read_vtu(folder / "solution.vtu")
    space = DisplacementSpace(problem)
    is_remeshed = not np.array_equal(fields.triangles, space.elements)
    if is_remeshed:
        remeshed = _on_written_mesh(problem, folder, fields)
        if remeshed is None:
            return None
        problem, space = remeshed, DisplacementSpace(remeshed)
    multipliers = fields.multipliers
    if multipliers is not None:
        multipliers = replace(multipliers, limit=multipliers.limit[: space.n_vertices])
    return KeptSolution(
        problem=problem,
        mesh=relocated_mesh(problem.mesh, fields.nodes[:, : space.n_vertices]),
        displacement=fields.displacement,
        pressure=fields.pressure,
        multipliers=multipliers,
        is_remeshed=is_remeshed,
        designed=designed,
        objective=str(record.get("objective")),
        history=single_result(folder, record).steps(),
    )


def _on_written_mesh(problem: ContactProblem, folder: Path, fields: Fields) -> ContactProblem | None:
    """The problem on the mesh that was written with its solution, before relocation.

    None without that mesh, or if the problem names nodes by numbers, which are those of the given mesh.
    """
    path = folder / WRITTEN
    if not path.exists() or problem.motion.numbers or problem.point_loads:
        return None
    mesh = read_mesh(path)
    vertices, triangles = fields.initial[:, : mesh.p.shape[1]], fields.triangles[:3]  # which files have first
    if not np.array_equal(np.sort(mesh.t, axis=0), np.sort(triangles, axis=0)):
        return None
    edges = {name: mesh.facets[:, facets].T for name, facets in (mesh.boundaries or {}).items()}
    made = from_arrays(vertices.T, triangles.T, edges, mesh.subdomains)
    return on_mesh(problem, made, problem.motion)
