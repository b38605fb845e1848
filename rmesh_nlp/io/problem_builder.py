"""From the checked tables of a problem file to a contact problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from inspect import Parameter
from typing import Any, TypeVar

import numpy as np
from skfem import MeshTri

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import one_line
from rmesh_nlp.expressions import value_of
from rmesh_nlp.fem.constraints import checked
from rmesh_nlp.io.problem_messages import Place, Source, outwards
from rmesh_nlp.io.problem_schema import (
    FORCES,
    FOUNDATIONS,
    LAWS,
    SHAPES,
    ContactTable,
    CurveTable,
    MaterialTable,
    PointLoadTable,
    ProblemTable,
    Table,
    arguments,
)
from rmesh_nlp.io.problem_values import SYMMETRY
from rmesh_nlp.meshes import named
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline, fitted_circle, spline_through
from rmesh_nlp.meshes.geometry import nodes_of
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.problem import (
    Constraint,
    ContactProblem,
    DesignVariable,
    Dirichlet,
    Law,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PointLoad,
    ProblemError,
    Shape,
    Traction,
    Units,
)
from rmesh_nlp.problem.conditions import symmetric
from rmesh_nlp.problem.obstacle import unit

T = TypeVar("T")

SAME_PLACE = 1e-6
"""Distance, in units of the extent of the mesh, at which a node is at the place that a load names."""

KEYS: Mapping[str, tuple[str, ...]] = {
    "law": ("source", "body_force"),
    "obstacle": ("interior", *FOUNDATIONS),
    "boundary": ("boundary",),
    "friction": ("friction",),
    "coulomb": ("coulomb",),
    "point_loads": ("force",),
    "design": ("boundary",),
}
"""Entries of a table that an error of each part of a problem may speak of, if it says of which of several."""


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
        obstacles, supports, curves = [], [], {}
        for number, contact in enumerate(table.contact):
            with at("contact", number, *contact.given("line", "circle")):
                obstacles.append(replace(_obstacle(contact, n), gap=contact.gap))
        for name, value in table.dirichlet.items():
            with at("dirichlet", name):
                supports.append(symmetric(mesh, name, n) if value == SYMMETRY else Dirichlet(name, value))
        for name, curve in table.curves.items():
            with at("curves", name):
                curves[name] = _curve(curve, mesh, name)
        rules = table.motion.entries()
        if self.design() and "motion" not in table.model_fields_set:
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
                point_loads=tuple(self.point_load(k, load, mesh) for k, load in enumerate(table.point_loads)),
                units=Units(**table.units.entries()),
                order=table.order if order is None else order,
                design=self.design(),
                constraints=self.constraints(),
            )
        except ProblemError as error:
            raise self.source.error(self.place(error), one_line(error)) from error
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

    def place(self, error: ProblemError) -> Place:
        """Where in the file an error of the problem has its cause."""
        part = error.part
        which: Place = () if error.name is None else (error.name,)
        if part in ("law", "subdomain"):
            table: Place = ("materials", *which) if self.table.material is None else ("material",)
        elif part in ("obstacle", "boundary", "friction", "coulomb"):
            table = ("contact", *which)
        elif part == "design" and which:
            table = ("design", "shapes", *which)
        else:
            table = (part, *which)
        keys = KEYS.get(part, ()) if which else ()
        return self.source.first([*((*table, key) for key in keys), *outwards(table)])

    def mesh(self) -> MeshTri:
        spec = self.table.mesh
        if spec.file is not None:
            mesh = self.made("a mesh from a file", spec, [self.read], "mesh")
        else:
            mesh = self.made(f"the shape {spec.shape!r}", spec, [SHAPES[str(spec.shape)]], "mesh")
        groups = {"boundaries": self.table.boundaries, "subdomains": self.table.subdomains}
        for kind, conditions in groups.items():
            for name, condition in conditions.items():
                with self.source.at(kind, name):
                    mesh = named(mesh, **{kind: {name: lambda p, c=condition: c.on(p) > 0.5}})
        return mesh

    def read(self, file: str) -> MeshTri:
        """The mesh of a file beside the problem file."""
        with self.source.at("mesh", "file"):
            return read_mesh(self.source.path.parent / file)

    def law(self, spec: MaterialTable, *place: str) -> Law:
        return self.made(f"the law {spec.law!r}", spec, LAWS[spec.law], *place)

    def made(self, what: str, table: Table, makes: list[Callable[..., T]], *place: str) -> T:
        """The first that takes the entries of a table, called with them."""
        entries = {name: value for name, value in table.entries().items() if name not in ("shape", "law")}
        taken = [arguments(make) for make in makes]
        keys = list(dict.fromkeys(name for names in taken for name in names))
        for name in entries:
            if name not in keys:
                raise self.source.error((*place, name), f"{what} takes {', '.join(keys)}")
        needed = [
            [name for name, argument in names.items() if argument.default is Parameter.empty]
            for names in taken
        ]
        for make, names, least in zip(makes, taken, needed, strict=True):
            if set(least) <= entries.keys() <= names.keys():
                with self.source.at(*place):
                    return make(**entries)
        raise self.source.error(place, f"{what} needs {', or '.join(map(' and '.join, needed))}")

    def point_load(self, number: int, load: PointLoadTable, mesh: MeshTri) -> PointLoad:
        """The load at the node that is where the file says."""
        distance = np.linalg.norm(mesh.p - np.array(load.at)[:, None], axis=0)
        node = int(np.argmin(distance))
        if distance[node] > SAME_PLACE * float(np.max(np.ptp(mesh.p, axis=1))):
            x, y = mesh.p[:, node]
            said = f"no node is there; the nearest is at [{x:.6g}, {y:.6g}]"
            raise self.source.error(("point_loads", number, "at"), said)
        return PointLoad(node, **load.entries("force"))


def _obstacle(table: ContactTable, components: int) -> Obstacle:
    if table.interior is not None:
        return Obstacle.interior(table.interior)
    common = table.entries("boundary", *FORCES)
    if table.circle is not None:
        return Obstacle.circle(**common, **table.circle.entries())
    if table.line is not None:
        return Obstacle.line(**common, **table.line.entries())
    if table.curve is not None:
        return Obstacle.curve(**common, level=table.curve)
    if table.points is not None:
        return Obstacle.graph(**common, height=PiecewiseLinear(*zip(*table.points, strict=True)))
    if table.height is not None:
        return Obstacle.graph(**common, height=table.height)
    normal = (1.0,) if components == 1 else unit(table.normal or (0.0, 1.0))
    return Obstacle(**common, **table.entries("offset"), normal=normal)


def _of_parameter(text: str | None) -> Callable[[Any], Any]:
    """An expression of t as a function."""
    return lambda t: value_of(str(text), {"t": t})


def _curve(table: CurveTable | str, mesh: MeshTri, name: str) -> Curve:
    """The curve that the file gives the boundary ``name``."""
    if table == "circle":
        return fitted_circle(np.asarray(mesh.p[:, nodes_of(mesh, name)]))
    if table == "spline":
        return spline_through(np.asarray(mesh.p), mesh.facets[:, np.asarray(mesh.boundaries[name])])
    assert not isinstance(table, str)
    if table.circle is not None:
        x, y, radius = table.circle
        return Circle((x, y), radius)
    if table.spline is not None:
        return Spline(tuple(table.spline), table.closed)
    assert table.t is not None
    return Parametrised(_of_parameter(table.x), _of_parameter(table.y), table.t, table.closed)
