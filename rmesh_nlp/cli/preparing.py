"""What ``rmesh new``, ``check``, ``advise``, ``remesh`` do, and what ``[solve]`` of a problem file asks."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from skfem import MeshTri

from rmesh_nlp.cli import load
from rmesh_nlp.cli.folders import check_target, notes
from rmesh_nlp.contact.setup_warnings import check as signs_of
from rmesh_nlp.contact.setup_warnings import curve_warnings
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.display import Rows, figure, plain_table
from rmesh_nlp.errors import BadInputError, located, one_line
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.io.export import write_mesh
from rmesh_nlp.io.folder import safe_name, write_whole
from rmesh_nlp.io.problem_file import load_problem as read_problem
from rmesh_nlp.io.problem_file import read_table, template
from rmesh_nlp.io.records import to_json
from rmesh_nlp.mapping import Mobility
from rmesh_nlp.mapping.validity import least_angles
from rmesh_nlp.meshes import MeshRepairWarning, named
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, named_by_user, pieces_of
from rmesh_nlp.meshes.reading import FORMATS, read_mesh
from rmesh_nlp.models.remeshing import Solved, metric_start
from rmesh_nlp.problem import ContactProblem, Laplace, Motion
from rmesh_nlp.settings import ByName, Values
from rmesh_nlp.solving.advice import advise as advice
from rmesh_nlp.solving.formulation import checked
from rmesh_nlp.solving.plan import Plan
from rmesh_nlp.study.study_file import is_study


def new(path: Path, study: bool, mesh: Path | None = None, two_bodies: bool = False) -> None:
    """Write a commented template, of a mesh file if one is given; an existing file is never replaced."""
    name = safe_name(path.stem)
    values = {"name": name, "file": name + path.suffix} | ({} if mesh is None else _of_mesh(mesh, path))
    if two_bodies:
        values["form"] = "two_bodies.toml"
    text = template("rmesh_nlp.study" if study else "rmesh_nlp.io", **values)
    with path.open("x", encoding="utf-8") as file:
        file.write(text)
    following = f"study {path} --out {name} --dry-run" if study else f"check {path}"
    print(f"wrote {path}; next: rmesh {following}")


def _of_mesh(path: Path, beside: Path) -> Values:
    """What the template has of a mesh: of its outer boundaries the lowest is in contact, the highest moves.

    So does the highest of each further part. Vertical ones, such as an axis, are left aside. Where the file
    does not name two, these are parts by height.
    """
    mesh = _read(path)
    (x, y), groups = mesh.p, named_by_user(mesh.boundaries)
    nodes = {n: mesh.facets[:, e] for n, e in groups.items() if np.isin(e, mesh.boundary_facets()).all()}
    flat = [name for name, on in nodes.items() if np.ptp(x[on]) > SEVEN_DIGITS * np.ptp(x)]
    names = sorted(flat, key=lambda name: y[nodes[name]].mean())
    piece = pieces_of(mesh.facets, x.size)
    of_piece = {number: name for name in names[1:] for number in piece[nodes[name]].flat}
    comment = "# " * (len(names) > 1)
    moved = list(dict.fromkeys(of_piece.values())) if comment else ["highest-tenth"]
    tenth = np.ptp(y) / 10
    return {
        "form": "mesh_template.toml",
        "mesh": Path(os.path.relpath(path, beside.parent)).as_posix(),
        "names": ", ".join([*groups, *named_by_user(mesh.subdomains)]),
        "comment": comment,
        "first": names[0] if comment else "lowest-tenth",
        "last": moved[-1],
        "given": "\n".join(f'"{name}" = [0.0, "-{tenth}/100"]' for name in moved),
        "pinned": moved,
        "low": y.min(),
        "tenth": tenth,
    }


def _read(path: Path) -> MeshTri:
    with notes(MeshRepairWarning, f"note: {path}"):
        return read_mesh(path)


def check(path: Path, picture: Path | None = None, order: int | None = None) -> None:
    """Validate a problem file, print what it says, draw mesh, roles and motion; or a mesh file or a study."""
    if path.suffix.lower() in FORMATS:
        mesh = _read(path)
        names = named_by_user(mesh.boundaries)
        mesh = named(mesh, {"outside": lambda x: x[0] == x[0]})
        problem = ContactProblem(mesh, Laplace(0.0), ("outside", *names), motion=Motion(0), name=path.name)
        said = f"a mesh, by its size in {'mm' if np.ptp(mesh.p) > 2 else 'm'}"
        rows = problem.summary()[:4]
        messages = [sign.message for sign in curve_warnings(problem, names)]
    elif is_study(path):
        if order is not None:
            raise BadInputError(f"--order {order} is for problem files: write it into {path}")
        load("cli.study").check(path)
        return
    else:
        problem, rows, messages = _checked(path, order)
        doubts = f"states a problem, with {len(messages)} doubt{'s' * (len(messages) > 1)}"
        said = doubts if messages else "is in order"
        said = f"problem {problem.name!r} {said}"
    print(plain_table(f"{path}: {said}", rows))
    for message in messages:
        print(f"warning: {message}")
    target = picture or path.with_suffix(".png")
    try:
        load("report.problem_picture").draw_problem(problem.at_design(), target)
    except (OSError, ValueError) as error:
        raise BadInputError(f"cannot draw to {target}: {one_line(error)}") from error
    print(f"drew {target}")


def _checked(path: Path, order: int | None) -> tuple[ContactProblem, Rows, list[str]]:
    """The problem of a file, what it says, and signs of a wrong set-up."""
    problem = load_problem(path, order)
    name, asked = solve_options(path, None, {})
    parts = discretise(problem)
    free = parts.mesh_map
    rows = problem.summary()
    if "regularisation" in asked and problem.motion.delta is not None and problem.motion.min_angle == 0:
        rows.append(("regularisation", "a barrier in the place of the least area: areas are only positive"))
    rows += [(f"nodes {kind.name.lower()}", str(np.sum(free.mobility == kind))) for kind in Mobility]
    rows += [("outer variables", str(free.n)), ("validity constraints", str(parts.validity.size))]
    rows += [("unknowns of the displacement", str(parts.n_u))]
    with located(path):
        plan = Plan.of(problem, name, **asked)
        _ = plan.outer(plan.problem).at_start  # its objective is evaluated
        return problem, rows, signs_of(problem)


def advise(path: Path, order: int | None = None, json: bool = False) -> None:
    """Print what moving nodes, a new mesh and refinement can attain for the problem of a file."""
    problem = _first_design(path, load_problem(path, order, says=not json), says=not json)
    with located(path):
        estimates = advice(problem)
    if json:
        print(to_json(estimates.record()))
    else:
        print(plain_table(f"{path}: which mesh?", estimates.rows()))


def remesh(path: Path, nodes: int | None, out: Path, order: int | None = None) -> None:
    """Write a mesh that suits the solution of the problem of a file."""
    check_target(out, ".msh")
    source = read_table(path).mesh.file
    if source is not None and out.exists() and out.samefile(path.parent / source):
        raise BadInputError(f"--out {out}: this is the mesh of {path}, choose another name")
    problem = replace(with_edge_gaps(_first_design(path, load_problem(path, order))), quadrature="auto")
    with located(path):
        first = Solved.of(problem)
        made = metric_start(first, problem.n_vertices if nodes is None else nodes).solved
    mesh = made.problem.mesh
    write_whole(out, lambda aside: write_mesh(mesh, aside))
    rows = [
        ("mesh", f"{mesh.p.shape[1]} nodes, {mesh.nelements} triangles"),
        ("energy", f"{figure(made.state.energy)}, on the given mesh {figure(first.state.energy)}"),
        ("error of the energy, estimated", f"{figure(made.error)}, on the given mesh {figure(first.error)}"),
        ("least angle", f"{np.min(least_angles(mesh.p, made.problem.triangles)):.3g} degrees"),
    ]
    print(plain_table(f"wrote {out}", rows))


def _first_design(path: Path, problem: ContactProblem, *, says: bool = True) -> ContactProblem:
    """The problem at its first design, which is said."""
    if says and problem.design:
        print(f"note: {path}: for the first design; `rmesh solve` finds others")
    return problem.at_design()


def load_problem(path: Path, order: int | None = None, *, says: bool = True) -> ContactProblem:
    """The problem of a file, or with another order; repairs of its mesh are printed as notes."""
    with notes(MeshRepairWarning, f"note: {path}", says=says):
        return read_problem(path, order)


def solve_options(path: Path, formulation: str | None, given: ByName) -> tuple[str, Values]:
    """Formulation and options of ``[solve]``, overridden by what is given on the command line.

    Raises BadInputError for an unknown formulation or objective, or an option that is not taken.
    """
    table = read_table(path)
    plan = table.solve
    name = formulation or plan.formulation
    asked = {**plan.options(), **given}
    with located(f"{path}: solve") if formulation or given else table.source.at("solve"):
        return name, checked(name, asked)
