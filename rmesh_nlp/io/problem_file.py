"""Contact problems from TOML files. Every error is one line: file, key, value, what was expected."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError
from skfem import MeshTri

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.io.problem_messages import (
    ProblemFileError,
    as_text,
    at_key,
    contact_key,
    deepest_line,
    error_at,
    nearest,
    one_line,
    pydantic_line,
    shown,
    unquoted,
    value_at,
)
from rmesh_nlp.io.problem_schema import SYMMETRY, ContactTable, MeshTable, MotionTable, ProblemTable
from rmesh_nlp.meshes import named, read_mesh, shapes
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Motion,
    Obstacle,
    PiecewiseLinear,
    PointLoad,
    ProblemError,
    Relative,
    Traction,
    Units,
)
from rmesh_nlp.problem.conditions import symmetric
from rmesh_nlp.problem.laws import Laplace, Law, PlaneStrain, PlaneStress

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found,unused-ignore]


import casadi as ca

from rmesh_nlp.expressions import value_of
from rmesh_nlp.io.problem_schema import CurveTable
from rmesh_nlp.meshes.curves import Circle, Curve, Parametrised, Spline, fitted_circle, spline_through
from rmesh_nlp.problem.lines import nodes_of

LARGEST_FILE = 1_000_000
"""Bytes that a problem file may have."""

DEEPEST = 20
"""How deep tables and lists may be nested; a valid file needs five."""

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

_KEY_OF_PART = {
    "mesh": "mesh",
    "law": "materials",
    "dirichlet": "dirichlet",
    "obstacle": "contact",
    "friction": "contact.friction",
    "motion": "motion",
    "curves": "curves",
    "tractions": "tractions",
}


def load_problem(path: str | Path) -> ContactProblem:
    """The contact problem that a TOML file states.

    Raises
    ------
    ProblemFileError
        With one line per error, each naming file, key, value and what was expected.
    """
    return build(read_table(path), Path(path))


def read_table(path: str | Path) -> ProblemTable:
    """The checked tables of a problem file, its mesh not yet read."""
    path = Path(path)
    data = read_toml(path)
    try:
        return ProblemTable.model_validate(data)
    except ValidationError as error:
        raise ProblemFileError([pydantic_line(path, item, data) for item in error.errors()]) from error


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file as they stand there.

    Raises
    ------
    ProblemFileError
        If the file cannot be read, is too large, too deep or no TOML; an expression without quotes is named.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ProblemFileError([f"{path}: cannot be read: {error.strerror}"]) from error
    if len(raw) > LARGEST_FILE:
        raise ProblemFileError([f"{path}: has {len(raw)} bytes: more than {LARGEST_FILE} are not read"])
    try:
        data = tomllib.loads(raw.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        hint = unquoted(raw, str(error))
        raise ProblemFileError([f"{path}: {hint or f'is not valid TOML: {one_line(error)}'}"]) from error
    except RecursionError as error:
        raise ProblemFileError([_too_deep(path, raw)]) from error
    if _depth(data) > DEEPEST:
        raise ProblemFileError([_too_deep(path, raw)])
    return data


def _depth(data: Any) -> int:
    """How deep tables and lists are nested; no function calls itself, however deep that is."""
    depth, level = 0, [data]
    while level := [one for one in level if isinstance(one, (dict, list))]:
        depth += 1
        level = [v for one in level for v in (one.values() if isinstance(one, dict) else one)]
    return depth


def _too_deep(path: Path, raw: bytes) -> str:
    return f"{path}: line {deepest_line(raw)}: tables and lists are nested more than {DEEPEST} deep"


def build(table: ProblemTable, path: Path) -> ContactProblem:
    """Read the mesh and put the problem together."""
    mesh = _mesh(table, path)
    laws = {name: _law(table, f"materials.{name}", path) for name in table.materials}
    law = laws or _law(table, "material", path)
    _check_names(table, mesh, path)
    n = next(iter(laws.values())).components if laws else law.components  # type: ignore[union-attr]
    for section, entries in (("dirichlet", table.dirichlet), ("tractions", table.tractions)):
        for name, value in entries.items():
            if value != SYMMETRY and len(value) != n:
                raise error_at(
                    path, f"{section}.{name}", as_text(value), f"expected {n} value{'s' * (n > 1)}"
                )
    obstacles = []
    for number, contact in enumerate(table.contact):
        with at_key(path, contact_key(table, number), table):
            obstacles.append(replace(_obstacle(contact, n), gap=contact.gap))
    loads = tuple(_point_load(table, number, mesh, n, path) for number in range(len(table.point_loads)))
    supports = []
    for name, value in table.dirichlet.items():
        with at_key(path, f"dirichlet.{name}", table):
            supports.append(symmetric(mesh, name, n) if value == SYMMETRY else Dirichlet(name, value))
    with at_key(path, "motion", table):
        motion = _motion(table.motion)
    for name, curve in table.curves.items():
        with at_key(path, f"curves.{name}", table):
            motion = replace(motion, curves={**motion.curves, name: curve_of(curve, mesh, name)})
    try:
        problem = ContactProblem(
            mesh=mesh,
            law=law,
            dirichlet=tuple(supports),
            obstacle=obstacles[0] if len(obstacles) == 1 else tuple(obstacles),
            motion=motion,
            tractions=tuple(Traction(name, value) for name, value in table.tractions.items()),
            quadrature=table.quadrature,
            name=table.name or path.stem,
            size=f"{mesh.t.shape[1]} triangles",
            point_loads=loads,
            units=Units(table.units.length, table.units.force),
        )
    except ProblemError as error:
        raise error_at(path, *_at_fault(table, error), one_line(error)) from error
    with at_key(path, "motion", table):
        _ = discretise(problem).validity  # the rules of the motion can be obeyed
    return problem


def _at_fault(table: ProblemTable, error: ProblemError) -> tuple[str, str]:
    """Key and value that an error of the problem speaks of."""
    part, name = error.part, error.name
    if part == "law" and name is not None:
        key, law = "material", table.material
        if law is None:
            key, law = f"materials.{name}", table.materials[str(name)]
        field = "source" if law.law == "laplace" else "body_force"
        return f"{key}.{field}", as_text(getattr(law, field))
    if part in ("obstacle", "friction") and name is not None:
        key, contact = contact_key(table, int(name)), table.contact[int(name)]
        fields = ("friction",) if part == "friction" else FOUNDATIONS
        field = next((field for field in fields if getattr(contact, field) is not None), "boundary")
        return f"{key}.{field}", as_text(getattr(contact, field))
    key = "material" if part == "law" and table.material else _KEY_OF_PART[part]
    if part in ("tractions", "dirichlet") and name is not None:
        key = f"{key}.{name}"
    return key, shown(table, key)


FOUNDATIONS = ("interior", "height", "offset", "points", "line", "circle", "curve")
"""Keys of a contact that say where the foundation is."""


def _mesh(table: ProblemTable, path: Path) -> MeshTri:
    spec = table.mesh
    if spec.file is not None:
        _refuse_other_keys(spec, ("file",), path)
        with at_key(path, "mesh.file", table):
            mesh = read_mesh(path.parent / spec.file)
    else:
        function, needed, further = SHAPES[str(spec.shape)]
        _refuse_other_keys(spec, ("shape", *needed, *further), path)
        for key in needed:
            if getattr(spec, key) is None:
                raise error_at(path, f"mesh.{key}", "nothing", f"the shape {spec.shape!r} needs it")
        keys = {key: getattr(spec, key) for key in (*needed, *further) if getattr(spec, key) is not None}
        with at_key(path, "mesh", table):
            mesh = function(**keys)
    for kind, conditions in (("boundaries", table.boundaries), ("subdomains", table.subdomains)):
        for name, condition in conditions.items():
            with at_key(path, f"{kind}.{name}", table):
                mesh = named(mesh, **{kind: {name: lambda p, c=condition: c.on(p) > 0.5}})
    return mesh


def _refuse_other_keys(spec: MeshTable, known: tuple[str, ...], path: Path) -> None:
    for key in type(spec).model_fields:
        if key in spec.model_fields_set and key not in known:
            what = f"the shape {spec.shape!r}" if spec.shape else "a mesh from a file"
            raise error_at(
                path, f"mesh.{key}", as_text(getattr(spec, key)), f"{what} takes {', '.join(known)}"
            )


def _law(whole: ProblemTable, key: str, path: Path) -> Law:
    table: Any = value_at(whole, key)
    scalar = ("source", "conductivity")
    elastic = ("young", "poisson", "lame_lambda", "lame_mu", "body_force")
    known = scalar if table.law == "laplace" else elastic
    for name in type(table).model_fields:
        if name in table.model_fields_set and name not in ("law", *known):
            value = as_text(getattr(table, name))
            raise error_at(path, f"{key}.{name}", value, f"the law {table.law!r} takes {', '.join(known)}")
    with at_key(path, key, whole):
        if table.law == "laplace":
            return Laplace(
                0.0 if table.source is None else table.source,
                1.0 if table.conductivity is None else table.conductivity,
            )
        kind = PlaneStrain if table.law == "plane-strain" else PlaneStress
        force = table.body_force or (0.0, 0.0)
        given = [k for k in ("young", "poisson", "lame_lambda", "lame_mu") if getattr(table, k) is not None]
        if given == ["lame_lambda", "lame_mu"]:
            return kind(table.lame_lambda, table.lame_mu, force)
        if given == ["young", "poisson"]:
            return kind.from_young(table.young, table.poisson, force)
        raise ValueError("expected either young and poisson, or lame_lambda and lame_mu")


def _point_load(table: ProblemTable, number: int, mesh: MeshTri, components: int, path: Path) -> PointLoad:
    """The load at the node that is where the file says."""
    load, key = table.point_loads[number], f"point_loads[{number + 1}]"
    distance = np.linalg.norm(mesh.p - np.array(load.at)[:, None], axis=0)
    node = int(np.argmin(distance))
    if distance[node] > SAME_PLACE * float(np.max(np.ptp(mesh.p, axis=1))):
        x, y = mesh.p[:, node]
        raise error_at(
            path, f"{key}.at", as_text(load.at), f"no node is there; the nearest is at [{x:.6g}, {y:.6g}]"
        )
    if len(load.force) != components or any(callable(value) for value in load.force):
        raise error_at(path, f"{key}.force", as_text(load.force), f"expected {components} numbers")
    return PointLoad(node, tuple(load.force))


def _obstacle(table: ContactTable, components: int) -> Obstacle:
    if table.interior is not None:
        if table.friction is not None:
            raise ValueError("friction needs contact on a boundary")
        return Obstacle.interior(table.interior)
    friction = 0.0 if table.friction is None else table.friction
    boundary = str(table.boundary)
    if table.circle is not None or table.curve is not None:
        if components == 1:
            raise ValueError("a circle or a curve needs an elastic body")
        if table.circle is not None:
            circle = table.circle
            return Obstacle.circle(
                boundary, circle.centre, circle.radius, inside=circle.inside, friction=friction
            )
        if not callable(table.curve):
            raise ValueError("expected an expression of x and y that is zero on the curve")
        return Obstacle.curve(boundary, table.curve, friction)
    if table.line is not None:
        return Obstacle.line(boundary, table.line.point, table.line.normal, friction)
    if table.height is not None:
        return Obstacle.graph(boundary, table.height, friction)
    if table.points is not None:
        x, y = zip(*table.points, strict=True)
        return Obstacle.graph(boundary, PiecewiseLinear(x, y), friction)
    offset = 0.0 if table.offset is None else table.offset
    if components == 1:
        return Obstacle(boundary, (1.0,), offset, friction)
    normal = table.normal or (0.0, 1.0)
    length = float(np.hypot(*normal))
    if length == 0:
        raise ValueError("expected a normal that is not zero")
    return Obstacle(boundary, (normal[0] / length, normal[1] / length), offset, friction)


def _motion(table: MotionTable) -> Motion:
    delta = Relative(table.delta["relative"]) if isinstance(table.delta, dict) else table.delta
    return Motion(
        delta,
        pinned=table.pinned,
        slides=table.slides,
        free=table.free,
        tied=table.tied,
        min_area_fraction=table.min_area_fraction,
        min_angle=table.min_angle,
    )


UNNAMED = (
    'the mesh file names none: name its curves in gmsh, Physical Curve("left") = {1};, or boundaries by '
    "conditions under [boundaries]"
)
"""What to do with a file without physical groups."""


def _check_names(table: ProblemTable, mesh: MeshTri, path: Path) -> None:
    """Names of boundaries and subdomains, with the nearest known one in the message."""
    boundaries, subdomains = sorted(mesh.boundaries or {}), sorted(mesh.subdomains or {})
    used = [(f"dirichlet.{name}", name) for name in table.dirichlet]
    used += [(f"tractions.{name}", name) for name in table.tractions]
    used += [(f"curves.{name}", name) for name in table.curves]
    for rule in ("pinned", "slides", "free"):
        used += [(f"motion.{rule}", name) for name in getattr(table.motion, rule) if isinstance(name, str)]
    for number, contact in enumerate(table.contact):
        if contact.boundary is not None:
            used.append((f"{contact_key(table, number)}.boundary", contact.boundary))
    for key, name in used:
        if name not in boundaries:
            expected = f"expected a boundary of the mesh{nearest(name, boundaries)}"
            if table.mesh.file and not set(boundaries) - set(table.boundaries):
                expected += f"; {UNNAMED}"
            raise error_at(path, key, shown(table, key), expected)
    for name in table.materials:
        if name not in subdomains:
            expected = f"expected a subdomain of the mesh{nearest(name, subdomains)}"
            raise error_at(path, f"materials.{name}", shown(table, f"materials.{name}"), expected)


class OfParameter:
    """An expression of t, as a function that takes symbols and numbers."""

    def __init__(self, text: str) -> None:
        self.text = text
        t = ca.SX.sym("t")
        self._function = ca.Function("expression", [t], [value_of(text, {"t": t})])

    def __call__(self, t: Any) -> Any:
        """Its value."""
        return self._function(t)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, OfParameter) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)


def curve_of(table: CurveTable | str, mesh: MeshTri, name: str) -> Curve:
    """The curve that the file gives the boundary ``name``.

    Raises
    ------
    ValueError
        If it cannot be made, or not fitted to the nodes.
    """
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
    return Parametrised(
        OfParameter(str(table.x)), OfParameter(str(table.y)), table.t or (0.0, 1.0), table.closed
    )


def template(name: str, file: str) -> str:
    """The commented template of ``rmesh new``: a problem ``name`` in ``file`` that solves in a second."""
    text = files("rmesh_nlp.io").joinpath("template.toml").read_text(encoding="utf-8")
    return text.replace("{name}", name).replace("{file}", file)
