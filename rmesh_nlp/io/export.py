"""Results out: VTU with all fields, a PVD series of the iterations, meshes with names, pandas."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np
from skfem import MeshTri

from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.errors import expect, located
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.io.folder import write_text, write_whole
from rmesh_nlp.io.vtu import fields_of, file_mesh, three
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes.geometry import counter_clockwise, named_by_user, signed_areas
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.lines import element_zones
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.solution import Solution

if TYPE_CHECKING:
    import pandas as pd


QUADRATIC = {
    "vtu",
    "vtk",
    "vtk42",
    "vtk51",
    "xdmf",
    "gmsh",
    "gmsh22",
    "med",
    "exodus",
    "abaqus",
    "nastran",
    "permas",
}
"""Formats of meshio that have quadratic triangles."""

REFUSED = (meshio.ReadError, meshio.WriteError, FileNotFoundError)
"""What meshio raises for a suffix, or a format, that it does not know."""


def point_data(solution: Solution) -> dict[str, Array]:
    """Fields of the nodes of the displacement, by name; vectors have three components for VTU files.

    Those on the mesh before relocation begin with ``initial_``. ``motion`` is the vector from the initial
    position, ``mobility`` 0 pinned, 1 sliding, 2 free, 3 tied, -1 in the middle of an edge, which follows its
    ends; ``limit_multiplier`` (of move limits) as in :class:`rmesh_nlp.models.residual.OuterMultipliers`.
    """
    return fields_of(solution).point_data()


def cell_data(solution: Solution) -> dict[str, Array]:
    """Fields of the elements, by name.

    ``stress`` is (elements, 4), sigma_xx, sigma_yy, sigma_xy, sigma_zz at the centre, the mean of a stress
    that is linear, with ``von_mises`` of it; for a scalar problem ``flux``. ``area_ratio`` is the area over
    the initial one, ``least_angle`` in degrees, ``zone`` a number per set of subdomains. With a certificate
    ``error_bound`` and ``error_bound_initial`` are what each element adds to the bound of half the squared
    error, on the relocated and on the given mesh, and ``equilibrated_flux`` or ``equilibrated_stress`` (xx,
    yy, xy) is the mean of the field that proves it.
    """
    problem, nodes, certificate = solution.problem, solution.mesh.p, solution.certificate
    stress, triangles = stresses(problem, nodes, solution.displacement), problem.triangles
    data: dict[str, Array] = {
        "area_ratio": signed_areas(nodes, triangles) / signed_areas(solution.final.before, triangles),
        "least_angle": least_angles(nodes, triangles),
        "zone": element_zones(problem.mesh).astype(np.int32),
    }
    kind, written = ("flux", three) if problem.components == 1 else ("stress", _columns)
    data[kind] = written(stress)
    if kind == "stress":
        data["von_mises"] = von_mises(stress)
    if solution.multipliers is not None:
        data["area_multiplier"] = solution.multipliers.area
        data["angle_multiplier"] = solution.multipliers.angle
    if certificate is not None:
        data["error_bound"] = certificate.local
        data["error_bound_initial"] = certificate.local_initial
        data[f"equilibrated_{kind}"] = written(certificate.field)
    return data


def _columns(values: Array) -> Array:
    return np.ascontiguousarray(values.T)


def write_solution(solution: Solution, path: str | Path, file_format: str | None = None) -> None:
    """Write a solution with all its fields, in the format of the suffix; ``.vtu`` for ParaView.

    Formats without quadratic triangles get the vertices alone, with the values there.
    """
    expect("solution", solution, Solution)
    fields = fields_of(solution)
    points, cells = fields.final.nodes, fields.triangles
    of_nodes, of_cells = fields.point_data(), cell_data(solution)
    kind = file_format or meshio.extension_to_filetypes.get(Path(path).suffix, [""])[0]
    if len(cells) > 3 and kind not in QUADRATIC:
        vertices = slice(solution.mesh.p.shape[1])
        points, cells = points[:, vertices], cells[:3]
        of_nodes = {name: values[vertices] for name, values in of_nodes.items()}
    if kind == "vtu":  # what figures are made of
        of_nodes, of_cells = of_nodes | fields.foundations(), of_cells | fields.drawn_stresses()
    with located(path, REFUSED):
        file_mesh(points, cells, of_nodes, of_cells).write(path, file_format)


def write_mesh(mesh: MeshTri, path: str | Path) -> None:
    """Write a mesh with the names of its boundaries and subdomains.

    ``.msh`` gets physical groups (a facet of several boundaries appears once for each). In any
    other format of meshio the names are kept as scikit-fem does; :func:`rmesh_nlp.meshes.read_mesh`
    and ``skfem.MeshTri.load`` read them back.
    """
    path = Path(path)
    if path.suffix != ".msh":
        with located(path, REFUSED):
            mesh.save(path)
        return
    triangles = counter_clockwise(mesh.p, mesh.t)
    names: dict[str, Array] = {}
    lines, line_tags = [np.zeros((0, 2), int)], []
    for name, facets in named_by_user(mesh.boundaries).items():
        names[name] = np.array((len(names) + 1, 1))
        lines.append(mesh.facets[:, facets].T)
        line_tags += [len(names)] * len(facets)
    tags = np.zeros(triangles.shape[1], int)
    for name, elements in named_by_user(mesh.subdomains).items():
        names[name] = np.array((len(names) + 1, 2))
        elements = np.arange(tags.size)[elements]
        tags[elements[tags[elements] == 0]] = len(names)  # a triangle is written once, under its first name
    blocks, numbers = [("triangle", triangles.T)], [tags]
    if line_tags:
        blocks.append(("line", np.vstack(lines)))
        numbers.append(np.array(line_tags))
    cell_data = {"gmsh:physical": numbers, "gmsh:geometrical": numbers}
    target = meshio.Mesh(three(mesh.p), blocks, cell_data=cell_data, field_data=names)
    with located(path, REFUSED):
        target.write(path, file_format="gmsh22", binary=False)


class Series:
    """Collects the iterates of a formulation and writes them as a PVD series that ParaView plays.

    Give it as ``on_step`` to a formulation, then call :meth:`write`. The displacement of each
    frame is the contact solution on its mesh, NaN where elements of an iterate are inverted.

    Parameters
    ----------
    problem : ContactProblem
    most : int, optional
        Keep no more than about so many, evenly; each costs a contact solve and a file.
    """

    def __init__(self, problem: ContactProblem, most: int | None = None) -> None:
        self.problem, self.most = problem, most
        self._steps: list[Step] = []

    def __call__(self, step: Step) -> None:
        """Note an iterate."""
        if step.q is not None:
            self._steps.append(step)

    @property
    def frames(self) -> int:
        """Number of iterates so far."""
        return len(self._steps)

    def names(self, name: str = "iterations") -> list[str]:
        """Names of the files that :meth:`write` will write."""
        return [f"{name}.pvd", *(self._file(step, name) for step in self._chosen())]

    def write(self, folder: str | Path, name: str = "iterations") -> Path:
        """Write ``name.pvd`` and one VTU file per frame, each whole; returns the path of the former."""
        folder = Path(folder)
        model, free = ContactSolver(self.problem), MeshMap.of(self.problem)
        space = model.discretisation.space
        entries, active = [], None
        for step in self._chosen():
            nodes = free.positions.values(np.asarray(step.q))
            unknowns = np.full(model.n_u, np.nan)
            if Body(self.problem, nodes).is_upright():
                design = free.design(np.asarray(step.q)) if self.problem.design else None
                state = solve(model.system(nodes, design), active)
                unknowns, active = state.u, state.active
            u = space.values(model.displacement.values(unknowns))
            file = self._file(step, name)
            points = space.points_on_body(nodes)
            fields = {
                "displacement": u[0] if u.shape[0] == 1 else three(u),
                "motion": three(points - space.points_on_body(self.problem.mesh.p)),
            }
            write_whole(folder / file, file_mesh(points, space.elements, fields).write)
            entries.append(f'    <DataSet timestep="{step.iteration}" file={quoteattr(file)}/>')
        path = folder / f"{name}.pvd"
        lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>"]
        write_text(path, "\n".join([*lines, *entries, "  </Collection>", "</VTKFile>", ""]))
        return path

    def _chosen(self) -> list[Step]:
        most = min(self.frames, max(2, self.most or self.frames))
        return [self._steps[i] for i in np.unique(np.linspace(0, self.frames - 1, most, dtype=int))]

    @staticmethod
    def _file(step: Step, name: str) -> str:
        return f"{name}-{step.iteration:05d}.vtu"


def node_table(solution: Solution) -> pd.DataFrame:
    """The fields of the nodes as a pandas table, one row per node, vectors by component."""
    x, y = DisplacementSpace(solution.problem).points_on_body(solution.mesh.p)
    return _table({"x": x, "y": y, **point_data(solution)})


def element_table(solution: Solution) -> pd.DataFrame:
    """The fields of the elements as a pandas table, one row per element."""
    elements = DisplacementSpace(solution.problem).elements
    nodes = {f"node_{k}": column for k, column in enumerate(elements, 1)}
    return _table({**nodes, **cell_data(solution)})


def _table(data: dict[str, Any]) -> pd.DataFrame:
    import pandas as pd  # loading it takes longer than a small solve

    axes = {(): [""], (2,): ["_x", "_y"], (3,): ["_x", "_y"], (4,): ["_xx", "_yy", "_xy", "_zz"]}
    return pd.DataFrame(
        {
            name + axis: column
            for name, values in data.items()
            for axis, column in zip(axes[values.shape[1:]], np.atleast_2d(values.T), strict=False)
        }
    )
