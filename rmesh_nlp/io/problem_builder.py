"""From the checked tables of a problem file to a contact problem."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from skfem import MeshTri

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.expressions import value_of
from rmesh_nlp.fem.constraints import checked
from rmesh_nlp.fem.objective_text import beside
from rmesh_nlp.io import problem_messages as messages
from rmesh_nlp.io.problem_messages import ProblemFileError, nearest, one_line
from rmesh_nlp.io.problem_schema import (
    ContactTable,
    CurveTable,
    MaterialTable,
    PointLoadTable,
    ProblemTable,
    Table,
)
from rmesh_nlp.io.problem_values import SYMMETRY
from rmesh_nlp.meshes import named, shapes
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline, fitted_circle, spline_through
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.problem import (
    Constraint,
    ContactProblem,
    DesignVariable,
    Dirichlet,
    Laplace,
    Law,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PlaneStrain,
    PlaneStress,
    PointLoad,
    ProblemError,
    Relative,
    Shape,
    Traction,
    Units,
)
from rmesh_nlp.problem.conditions import symmetric
from rmesh_nlp.problem.lines import nodes_of

if sys.version_info >= (3, 11):
    pass
else:
    pass  # type: ignore[import-not-found,unused-ignore]

SAME_PLACE = 1e-6
"""Distance, in units of the extent of the mesh, at which a node is at the place that a load names."""

SHAPES: dict[str, tuple[Callable[..., MeshTri], tuple[str, ...], tuple[str, ...]]] = {
    "rectangle": (shapes.rectangle, ("nx", "ny"), ("x", "y", "diagonal")),
    "l-shape": (shapes.l_shape, ("h",), ("size",)),
    "plate-with-hole": (shapes.plate_with_hole, ("h",), ("size", "radius")),
    "half-disc": (shapes.half_disc, ("h",), ("radius", "contact", "h_contact")),
    "wedge-block": (shapes.wedge_block, ("h",), ("width", "height", "rise")),
    "polygon": (shapes.polygon, ("points", "h"), ()),
}
"""Function, needed keys and further keys of every shape."""

ELASTIC = ("young", "poisson", "lame_lambda", "lame_mu", "body_force")
LAW_KEYS = {"laplace": ("source", "conductivity"), "plane-strain": ELASTIC, "plane-stress": ELASTIC}
"""Keys that a material of each law may have."""

FOUNDATIONS = ("interior", "height", "offset", "points", "line", "circle", "curve")
"""Keys of a contact that say where the foundation is."""

UNNAMED = (
    'the mesh file names none: name its curves in gmsh, Physical Curve("left") = {1};, or boundaries by '
    "conditions under [boundaries]"
)
"""What to do with a file without physical groups."""


def build(table: ProblemTable, path: Path) -> ContactProblem:
    """Read the mesh and put the problem together; ``path`` is where the file is."""
    return _Builder(table, path).problem()


@dataclass(frozen=True)
class _Builder:
    """Makes the problem of the tables of one file."""

    table: ProblemTable
    path: Path

    def at(self, key: str, value: Any) -> AbstractContextManager[None]:
        return messages.at_key(self.path, key, value)

    def wrong(self, key: str, value: Any, expected: str) -> ProblemFileError:
        return messages.error_at(self.path, key, value, expected)

    @cached_property
    def contacts(self) -> dict[str, ContactTable]:
        """By the keys that messages name; several are counted from 1."""
        contacts = self.table.contact
        return {
            "contact" if len(contacts) == 1 else f"contact[{k}]": one for k, one in enumerate(contacts, 1)
        }

    def problem(self) -> ContactProblem:
        table, mesh = self.table, self.mesh()
        laws = {name: self.law(f"materials.{name}", one) for name, one in table.materials.items()}
        law = laws or self.law("material", table.material)
        self.check_names(mesh)
        n = next(iter(law.values())).components if isinstance(law, dict) else law.components
        for section, entries in (("dirichlet", table.dirichlet), ("tractions", table.tractions)):
            for name, value in entries.items():
                if value != SYMMETRY and len(value) != n:
                    raise self.wrong(f"{section}.{name}", value, f"expected {n} value{'s' * (n > 1)}")
        obstacles, supports, curves = [], [], {}
        for key, contact in self.contacts.items():
            with self.at(key, contact):
                obstacles.append(
                    replace(_obstacle(contact, n), gap=contact.gap, coulomb=_or_zero(contact.coulomb))
                )
        loads = [self.point_load(k, load, mesh, n) for k, load in enumerate(table.point_loads, 1)]
        for name, value in table.dirichlet.items():
            with self.at(f"dirichlet.{name}", value):
                supports.append(symmetric(mesh, name, n) if value == SYMMETRY else Dirichlet(name, value))
        for name, curve in table.curves.items():
            with self.at(f"curves.{name}", curve):
                curves[name] = _curve(curve, mesh, name)
        rules = dict(table.motion)
        if table.design.names and "motion" not in table.model_fields_set:
            rules["delta"] = 0.0  # a design alone
        if isinstance(rules["delta"], dict):
            rules["delta"] = Relative(rules["delta"]["relative"])
        with self.at("motion", table.motion):
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
                name=table.name or self.path.stem,
                size=f"{mesh.t.shape[1]} triangles",
                point_loads=tuple(loads),
                units=Units(table.units.length, table.units.force),
                order=table.order,
                design=self.design(),
                constraints=self.constraints(),
            )
        except ProblemError as error:
            raise self.wrong(*self.fault(error), one_line(error)) from error
        with self.at("motion", table.motion):
            _ = discretise(problem).validity  # the rules of the motion can be obeyed
        return problem

    def design(self) -> tuple[DesignVariable | Shape, ...]:
        """Design variables, and the amplitudes of shapes after them."""
        found: list[DesignVariable | Shape] = []
        for name, variable in self.table.design.variables.items():
            with self.at(f"design.{name}", variable):
                found.append(DesignVariable(name, variable.start, variable.bounds))
        for name, shape in self.table.design.shapes.items():
            with self.at(f"design.shapes.{name}", shape):
                found.append(Shape(name, shape.boundary, shape.motion, shape.bounds))
        return tuple(found)

    def constraints(self) -> tuple[Constraint, ...]:
        """What designs must keep, with values that can be read."""
        found = []
        for number, one in enumerate(self.table.constraints, 1):
            with self.at(f"constraints[{number}]", one):
                found.append(checked(Constraint(beside(one.value, self.path.parent), one.bounds)))
        return tuple(found)

    def fault(self, error: ProblemError) -> tuple[str, Any]:
        """Key that an error of the problem speaks of, and what stands there."""
        table, part, name = self.table, error.part, error.name
        if part == "law":
            key, law = "material", table.material
            if law is None:
                if name is None:
                    return "materials", table.materials
                key, law = f"materials.{name}", table.materials[str(name)]
            if name is None:
                return key, law
            source = "source" if law.law == "laplace" else "body_force"
            return f"{key}.{source}", getattr(law, source)
        if part in ("obstacle", "friction", "coulomb"):
            key, contact = list(self.contacts.items())[int(name or 0)]
            if name is None:
                return (
                    ("contact", contact)
                    if part == "obstacle"
                    else (f"contact.{part}", getattr(contact, part))
                )
            given = contact.given(*(FOUNDATIONS if part == "obstacle" else (part,)))
            place = [*given, "boundary"][0]
            return f"{key}.{place}", getattr(contact, place)
        value: Any = getattr(table, part, None)
        if part in ("tractions", "dirichlet") and name is not None:
            return f"{part}.{name}", value[name]
        return part, value

    def mesh(self) -> MeshTri:
        spec = self.table.mesh
        if spec.file is not None:
            self.refuse_others("mesh", spec, ("file",), "a mesh from a file")
            with self.at("mesh.file", spec.file):
                mesh = read_mesh(self.path.parent / spec.file)
        else:
            function, needed, further = SHAPES[str(spec.shape)]
            what = f"the shape {spec.shape!r}"
            self.refuse_others("mesh", spec, (*needed, *further), what, besides="shape")
            given = {key: getattr(spec, key) for key in spec.given(*needed, *further)}
            for key in needed:
                if key not in given:
                    raise self.wrong(f"mesh.{key}", None, f"{what} needs it")
            with self.at("mesh", spec):
                mesh = function(**given)
        groups = {"boundaries": self.table.boundaries, "subdomains": self.table.subdomains}
        for kind, conditions in groups.items():
            for name, condition in conditions.items():
                with self.at(f"{kind}.{name}", condition):
                    mesh = named(mesh, **{kind: {name: lambda p, c=condition: c.on(p) > 0.5}})
        return mesh

    def refuse_others(
        self, place: str, spec: Table, known: tuple[str, ...], what: str, besides: str = ""
    ) -> None:
        """Refuse keys of a table that do not go with its shape or law."""
        for key in type(spec).model_fields:
            if key in spec.model_fields_set and key not in (*known, besides):
                raise self.wrong(f"{place}.{key}", getattr(spec, key), f"{what} takes {', '.join(known)}")

    def law(self, key: str, spec: MaterialTable | None) -> Law:
        assert spec is not None
        self.refuse_others(key, spec, LAW_KEYS[spec.law], f"the law {spec.law!r}", besides="law")
        values: dict[str, Any] = {name: getattr(spec, name) for name in spec.given(*LAW_KEYS[spec.law])}
        with self.at(key, spec):
            if spec.law == "laplace":
                return Laplace(**values)
            kind = PlaneStrain if spec.law == "plane-strain" else PlaneStress
            force = values.pop("body_force", (0.0, 0.0))
            if values.keys() == {"lame_lambda", "lame_mu"}:
                return kind(**values, body_force=force)
            if values.keys() == {"young", "poisson"}:
                return kind.from_young(**values, body_force=force)
            raise ValueError("expected either young and poisson, or lame_lambda and lame_mu")

    def point_load(self, number: int, load: PointLoadTable, mesh: MeshTri, components: int) -> PointLoad:
        """The load at the node that is where the file says."""
        key, distance = f"point_loads[{number}]", np.linalg.norm(mesh.p - np.array(load.at)[:, None], axis=0)
        node = int(np.argmin(distance))
        if distance[node] > SAME_PLACE * float(np.max(np.ptp(mesh.p, axis=1))):
            x, y = mesh.p[:, node]
            raise self.wrong(f"{key}.at", load.at, f"no node is there; the nearest is at [{x:.6g}, {y:.6g}]")
        if len(load.force) != components or any(callable(value) for value in load.force):
            raise self.wrong(f"{key}.force", load.force, f"expected {components} numbers")
        return PointLoad(node, tuple(load.force))

    def check_names(self, mesh: MeshTri) -> None:
        """Names of boundaries and subdomains, with the nearest known one in the message."""
        table, boundaries, subdomains = (
            self.table,
            sorted(mesh.boundaries or {}),
            sorted(mesh.subdomains or {}),
        )
        used = [
            (f"{section}.{name}", name, value)
            for section in ("dirichlet", "tractions", "curves")
            for name, value in getattr(table, section).items()
        ]
        for rule in ("pinned", "slides", "free"):
            places = getattr(table.motion, rule)
            used += [(f"motion.{rule}", name, places) for name in places if isinstance(name, str)]
        for name, shape in table.design.shapes.items():
            used.append((f"design.shapes.{name}.boundary", shape.boundary, shape.boundary))
        for key, contact in self.contacts.items():
            if contact.boundary is not None:
                used.append((f"{key}.boundary", contact.boundary, contact.boundary))
        for key, name, value in used:
            if name not in boundaries:
                expected = f"expected a boundary of the mesh{nearest(name, boundaries)}"
                if table.mesh.file and not set(boundaries) - set(table.boundaries):
                    expected += f"; {UNNAMED}"
                raise self.wrong(key, value, expected)
        for name, law in table.materials.items():
            if name not in subdomains:
                expected = f"expected a subdomain of the mesh{nearest(name, subdomains)}"
                raise self.wrong(f"materials.{name}", law, expected)


def _obstacle(table: ContactTable, components: int) -> Obstacle:
    if table.interior is not None:
        if table.given("friction", "coulomb"):
            raise ValueError("friction needs contact on a boundary")
        return Obstacle.interior(table.interior)
    boundary, friction = str(table.boundary), _or_zero(table.friction)
    if components == 1 and table.given("circle", "curve"):
        raise ValueError("a circle or a curve needs an elastic body")
    if (circle := table.circle) is not None:
        inside = circle.inside
        return Obstacle.circle(boundary, circle.centre, circle.radius, inside=inside, friction=friction)
    if table.curve is not None:
        if not callable(table.curve):
            raise ValueError("expected an expression of x and y that is zero on the curve")
        return Obstacle.curve(boundary, table.curve, friction)
    if table.line is not None:
        return Obstacle.line(boundary, table.line.point, table.line.normal, friction)
    if table.points is not None:
        return Obstacle.graph(boundary, PiecewiseLinear(*zip(*table.points, strict=True)), friction)
    if table.height is not None:
        return Obstacle.graph(boundary, table.height, friction)
    normal = np.array((1.0,) if components == 1 else table.normal or (0.0, 1.0))
    length = float(np.hypot(*normal)) if components == 2 else 1.0
    if length == 0:
        raise ValueError("expected a normal that is not zero")
    return Obstacle(boundary, tuple((normal / length).tolist()), _or_zero(table.offset), friction)


def _or_zero(coefficient: Any) -> Any:
    """What a file gives, zero where it gives nothing."""
    return 0.0 if coefficient is None else coefficient


@dataclass(frozen=True)
class OfParameter:
    """An expression of t, as a function that takes symbols and numbers."""

    text: str

    @cached_property
    def _function(self) -> ca.Function:
        t = ca.SX.sym("t")
        return ca.Function("expression", [t], [value_of(self.text, {"t": t})])

    def __call__(self, t: Any) -> Any:
        """Its value."""
        return self._function(t)


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
    return Parametrised(OfParameter(str(table.x)), OfParameter(str(table.y)), table.t, table.closed)
