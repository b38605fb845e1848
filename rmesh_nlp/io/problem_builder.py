"""From the checked tables of a problem file to a contact problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skfem import MeshTri

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import one_line
from rmesh_nlp.fem.constraints import checked
from rmesh_nlp.io.problem_messages import Source, outwards
from rmesh_nlp.io.problem_schema import (
    CURVES,
    FOUNDATIONS,
    LAWS,
    SHAPES,
    CurveTable,
    MaterialTable,
    ProblemTable,
    made,
)
from rmesh_nlp.io.problem_values import SYMMETRY
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.curves import Curve, fitted_circle, spline_through
from rmesh_nlp.meshes.geometry import members_of, node_at
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.problem import (
    Constraint,
    ContactProblem,
    DesignVariable,
    Dirichlet,
    Law,
    Motion,
    PointLoad,
    ProblemError,
    Shape,
    Traction,
    Units,
)
from rmesh_nlp.problem.conditions import symmetric


def build(table: ProblemTable, order: int | None = None) -> ContactProblem:
    """Read the mesh and put the problem together, or with displacements of another order."""
    return _Builder(table, table.source).problem(order)


@dataclass(frozen=True)
class _Builder:
    """Makes the problem of the tables of one file."""

    table: ProblemTable
    source: Source

    def problem(self, order: int | None) -> ContactProblem:
        table, mesh, at = self.table, self.mesh(), self.source.at
        laws = {name: self.law(spec, "materials", name) for name, spec in table.materials.items()}
        law = laws if table.material is None else self.law(table.material, "material")
        n = law.components if isinstance(law, Law) else next(iter(laws.values())).components
        obstacles, supports, loads, curves = [], [], [], {}
        for number, contact in enumerate(table.contact):
            with at("contact", number, *contact.given("line", "circle")):
                obstacles.append(contact.obstacle(n))
        for name, value in table.dirichlet.items():
            with at("dirichlet", name):
                supports.append(symmetric(mesh, name, n) if value == SYMMETRY else Dirichlet(name, value))
        for number, load in enumerate(table.point_loads):
            with at("point_loads", number, "at"):
                loads.append(PointLoad(node_at(mesh, load.at), **load.entries("at")))
        for name, curve in table.curves.items():
            with at("curves", name):
                curves[name] = _curve(curve, mesh, name)
        design, rules = self.design(), table.motion.entries()
        if design and "motion" not in table.model_fields_set:
            rules["delta"] = 0.0  # a design alone
        with at("motion"):
            motion = Motion(**rules, curves=curves)
        try:
            problem = ContactProblem(
                mesh=mesh,
                law=law,
                dirichlet=tuple(supports),
                obstacle=obstacles[0] if len(obstacles) == 1 else tuple(obstacles),
                motion=motion,
                tractions=tuple(Traction(name, value) for name, value in table.tractions.items()),
                quadrature=table.quadrature,
                name=table.name or self.source.path.stem,
                size=f"{mesh.t.shape[1]} triangles",
                point_loads=tuple(loads),
                units=Units(**table.units.entries()),
                order=table.order if order is None else order,
                design=design,
                constraints=self.constraints(),
            )
        except ProblemError as error:
            inside = [(*error.place, key) for key in FOUNDATIONS] if len(error.place) == 2 else []
            place = self.source.first([*inside, *outwards(error.place)])
            raise self.source.error(place, one_line(error)) from error
        with at("motion"):
            _ = discretise(problem).validity  # the rules of the motion can be obeyed
        return problem

    def design(self) -> tuple[DesignVariable | Shape, ...]:
        """Design variables, and the amplitudes of shapes after them."""
        result: list[DesignVariable | Shape] = []
        for name, variable in self.table.design.variables.items():
            with self.source.at("design", name):
                result.append(DesignVariable(name, **variable.entries()))
        for name, shape in self.table.design.shapes.items():
            with self.source.at("design", "shapes", name):
                result.append(Shape(name, **shape.entries()))
        return tuple(result)

    def constraints(self) -> tuple[Constraint, ...]:
        """What designs must keep, with values that can be read."""
        result = []
        for number, constraint in enumerate(self.table.constraints):
            with self.source.at("constraints", number):
                result.append(checked(Constraint(constraint.value, constraint.bounds)))
        return tuple(result)

    def mesh(self) -> MeshTri:
        spec, at = self.table.mesh, self.source.at
        with at("mesh", *spec.given("file")):
            if spec.file is None:
                mesh = made(f"the shape {spec.shape!r}", [SHAPES[str(spec.shape)]], spec.entries("shape"))
            else:
                mesh = made("a mesh from a file", [self.read], spec.entries())
        groups = {"boundaries": self.table.boundaries, "subdomains": self.table.subdomains}
        for kind, conditions in groups.items():
            for name, condition in conditions.items():
                with at(kind, name):
                    mesh = named(mesh, **{kind: {name: lambda p, c=condition: c.on(p) > 0.5}})
        return mesh

    def read(self, file: str) -> MeshTri:
        """The mesh of a file beside the problem file."""
        return read_mesh(self.source.path.parent / file)

    def law(self, spec: MaterialTable, *place: str) -> Law:
        with self.source.at(*place):
            return made(f"the law {spec.law!r}", LAWS[spec.law], spec.entries("law"))


def _curve(table: CurveTable | str, mesh: MeshTri, name: str) -> Curve:
    """The curve that the file gives the boundary ``name``, or one fitted to its nodes."""
    if isinstance(table, CurveTable):
        return made("a curve", CURVES, table.entries())
    edges = mesh.facets[:, members_of("boundary", name, mesh.boundaries)]
    if table == "circle":
        return fitted_circle(np.asarray(mesh.p[:, np.unique(edges)]))
    return spline_through(np.asarray(mesh.p), edges)
