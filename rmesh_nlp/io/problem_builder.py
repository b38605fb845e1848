"""From the checked tables of a problem file to a contact problem."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from skfem import MeshTri

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.errors import Place, one_line, unknown
from rmesh_nlp.evaluation import Array, Mask
from rmesh_nlp.fem.constraints import checked
from rmesh_nlp.io.problem_messages import outwards
from rmesh_nlp.io.problem_schema import FOUNDATIONS, CurveTable, ProblemTable, StepTable
from rmesh_nlp.io.problem_values import SYMMETRY
from rmesh_nlp.meshes.arrays import named, repaired
from rmesh_nlp.meshes.curves import Curve, fitted
from rmesh_nlp.meshes.geometry import node_at
from rmesh_nlp.problem import (
    Constraint,
    ContactProblem,
    DesignVariable,
    Dirichlet,
    Law,
    LoadStep,
    Motion,
    Obstacle,
    PointLoad,
    ProblemError,
    Shape,
    Traction,
    Units,
)
from rmesh_nlp.problem.coefficients import Coefficient, on_points
from rmesh_nlp.problem.conditions import symmetric
from rmesh_nlp.settings import Values


def build(table: ProblemTable, order: int | None = None) -> ContactProblem:
    """Read the mesh and put the problem together, or with displacements of another order."""
    source, at, mesh = table.source, table.source.at, _mesh(table)
    file = source.path.parent / (table.mesh.file or "")
    laws, curves = dict[str, Law](), dict[str, Curve]()
    obstacles = list[Obstacle]()
    for name, material in table.materials.items():
        with at("materials", name):
            laws[name] = material.made(file)
    if table.material is not None:
        with at("material"):
            laws[""] = table.material.made(file)
    n = next(iter(laws.values())).components
    for number, contact in enumerate(table.contact):
        with at("contact", number, *contact.given("line", "circle")):
            obstacles.append(contact.made(n))
    steps = tuple(
        LoadStep(**_conditions(table, step, mesh, n, ("steps", number)), tools=step.tools)
        for number, step in enumerate(table.steps)
    )
    for name, curve in table.curves.items():
        with at("curves", name):
            curves[name] = curve.made() if isinstance(curve, CurveTable) else fitted(mesh, name, curve)
    design, rules = _design(table), table.motion.entries()
    if design and "motion" not in table.model_fields_set:
        rules["delta"] = 0.0  # a design alone
    with at("motion"):
        motion = Motion(**rules, curves=curves)
    try:
        problem = ContactProblem(
            mesh=mesh,
            law=laws if table.material is None else laws[""],
            **_conditions(table, table, mesh, n),
            obstacle=obstacles[0] if len(obstacles) == 1 else tuple(obstacles),
            motion=motion,
            quadrature=table.quadrature,
            name=table.name or source.path.stem,
            size=f"{mesh.nelements} triangles",
            steps=steps,
            units=Units(**table.units.entries()),
            order=table.order if order is None else order,
            design=design,
            constraints=_constraints(table),
        )
    except ProblemError as error:
        inside = [(*error.place, key) for key in FOUNDATIONS] if len(error.place) == 2 else []
        place = source.first([*inside, *outwards(error.place)])
        raise source.error(place, one_line(error)) from error
    with at("motion"):
        _ = discretise(problem).validity  # the rules of the motion can be obeyed
    return problem


def _conditions(
    table: ProblemTable, loads: ProblemTable | StepTable, mesh: MeshTri, n: int, place: Place = ()
) -> Values:
    """Supports, tractions and forces at nodes of a file or of one of its load steps."""
    at, supports, forces = table.source.at, list[Dirichlet](), list[PointLoad]()
    for name, value in loads.dirichlet.items():
        with at(*place, "dirichlet", name):
            supports.append(symmetric(mesh, name, n) if value == SYMMETRY else Dirichlet(name, value))
    for number, load in enumerate(loads.point_loads):
        with at(*place, "point_loads", number, "at"):
            forces.append(PointLoad(node_at(mesh, load.at), **load.entries("at")))
    tractions = tuple(Traction(name, value) for name, value in loads.tractions.items())
    return {"dirichlet": tuple(supports), "point_loads": tuple(forces), "tractions": tractions}


def _mesh(table: ProblemTable) -> MeshTri:
    """The mesh with all its names."""
    with table.source.at("mesh", *table.mesh.given("file")):
        pairs = [contact.pair for contact in table.contact if contact.pair]
        mesh = table.mesh.made(table.source.path.parent, pairs)
    inside = {contact.interface for contact in table.contact}
    known = {*(mesh.boundaries or ()), *table.boundaries}
    for number, contact in enumerate(table.contact):
        if contact.interface and contact.interface not in known:
            with table.source.at("contact", number, "interface"):
                raise unknown("boundary", contact.interface, sorted(known))
    for kind, conditions in (("boundaries", table.boundaries), ("subdomains", table.subdomains)):
        for name, condition in conditions.items():
            with table.source.at(kind, name):

                def holds(p: Array, c: Coefficient = condition) -> Mask:
                    return on_points(c, p, "the condition") > 0.5

                of: Any = holds
                cells = mesh.p[:, mesh.facets if kind == "boundaries" else mesh.t]
                middle = cells.mean(axis=1, keepdims=True)
                if kind == "subdomains":
                    within = holds(0.99 * cells + 0.01 * middle)
                    if cut := np.ptp(1 * within, axis=0).sum():
                        said = (
                            f"the subdomain {name!r} ends inside {cut} triangles, off the lines of the mesh"
                        )
                        repaired(said)
                elif name in inside:  # edges of which both ends and the middle are on it
                    of = mesh.facets[:, holds(np.hstack([cells, middle])).all(axis=0)].T
                mesh = named(mesh, **{kind: {name: of}})
    return mesh


def _design(table: ProblemTable) -> tuple[DesignVariable | Shape, ...]:
    """Design variables, and the amplitudes of shapes after them."""
    result: list[DesignVariable | Shape] = []
    rest = str({key: part for key, part in table.source.data.items() if key != "design"})
    for name, variable in table.design.variables.items():
        with table.source.at("design", name):
            result.append(DesignVariable(name, **variable.entries()))
            if not re.search(rf"\b{name}\b", rest):
                raise ValueError("nothing in this file depends on it")
    for name, shape in table.design.shapes.items():
        with table.source.at("design", "shapes", name):
            result.append(Shape(name, **shape.entries()))
    return tuple(result)


def _constraints(table: ProblemTable) -> tuple[Constraint, ...]:
    """What designs must keep, with values that can be read."""
    result = []
    for number, constraint in enumerate(table.constraints):
        with table.source.at("constraints", number):
            result.append(checked(Constraint(constraint.value, constraint.bounds)))
    return tuple(result)
