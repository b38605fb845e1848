"""One solver on one problem, ours or a peer: the process that ``benchmark_peers.py`` starts for each run.

    python scripts/peers.py "joint/Pyomo, Ipopt" --n 8 --answer answer.jsonl

Writes one line of JSON per problem. A peer is imported where it is used, so that none is needed. Where a
peer stopped is judged by our own contact solve, or by the expressions of the MPCC, never by its own word.
Timed is everything from the stated problem to the solver's end; not timed are imports, a first solve on a
grid of 3 x 3 squares (it loads Ipopt), the contact solve on the initial grid that peers of ``joint`` start
from, and the judging.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from benchmark_mpcc import as_mpcc, load, plain_loop_result, relative_error
from scipy.optimize import Bounds, minimize

from formulations import joint, nested
from rmesh_nlp import mpcc
from rmesh_nlp.contact.model import ContactModel, solve
from rmesh_nlp.contact.system import ActiveSet
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.meshes import read_mesh
from rmesh_nlp.optimize.solver import IPOPT_OPTIONS, Solver
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, PlaneStrain, signed_areas
from rmesh_nlp.programs.energy_program import relocation
from rmesh_nlp.programs.outer_solvers import NestedSettings
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.solution.referee import Referee

REACHED, FEASIBLE = 1e-4, 1e-3
"""Largest error of the objective, and violation and min(G, H), of an MPCC that counts as solved.

The second is loose: solvers that stop at G H <= 1e-7 leave some 3e-4 where both are small.
"""

EPOCHS = 10000
"""Iterations that NeuROM-Py may take, as in its own example."""

SILENT = {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False}

PLATE = {"bottom": 111, "right": 112, "top": 113, "left": 114, "hole": 115, "body": 100}
"""Physical groups of the plate's mesh file."""


@dataclass(frozen=True)
class Finish:
    """Where a solver of a relocation problem stopped: positions (2, nodes), its own word, seconds."""

    nodes: Array
    status: str
    seconds: float


@dataclass(frozen=True)
class Answer:
    """One judged line: an energy and a least area, or whether an MPCC is solved."""

    status: str
    seconds: float
    failed: bool = False
    energy: float | None = None
    least_area: float | None = None
    solved: bool | None = None


@dataclass(frozen=True)
class Case:
    """A relocation problem, the file its mesh is from, and the seconds a solver may take."""

    problem: ContactProblem
    mesh: Path | None = None
    limit: float = float("inf")


class OutOfTimeError(Exception):
    """Raised inside a solver of SciPy to end it."""


# ---------------------------------------------------------------- all at once: the program of ``joint``


@dataclass(frozen=True, eq=False)
class Program:
    """Example 6.1 as numbers, to be stated in any modelling language.

    Unknowns ``x = (q, u)``; ``positions`` and ``displacement`` say how nodal values follow from them.
    """

    positions: Field
    displacement: Field
    triangles: Array
    contact: Array
    bound: Array
    start: Array
    unit: float

    def ipopt(self, limit: float) -> dict[str, Any]:
        """What ``joint`` gives Ipopt, and so every peer that uses Ipopt on the same program."""
        own = joint.JointSettings().options(areas=False, unit=self.unit)
        return {**IPOPT_OPTIONS, **own, "max_wall_time": min(limit, 1e6)}

    def nodes(self, x: Sequence[float]) -> Array:
        """Node positions of unknowns cut to their boxes."""
        values = np.array(x, dtype=float)
        return self.positions.values(np.clip(values, -self.bound, self.bound))


def program_of(problem: ContactProblem) -> Program:
    """The program of Example 6.1 and the start of ``joint``."""
    referee = Referee(problem)
    rel = referee.relocation
    if rel.n_valid or rel.n_s:
        raise ValueError("only for boxes that exclude inverted elements, and without friction")
    return Program(
        positions=rel.freedoms.positions,
        displacement=rel.displacement,
        triangles=problem.triangles.T,
        contact=problem.contact_nodes,
        bound=rel.nlp.ubx,
        start=referee.reduced.point(np.zeros(rel.n_q), referee.initial),
        unit=joint.pull(referee.reduced(np.zeros(rel.n_q)).gradient),
    )


def entries(field: Field, component: int, x: Any) -> list[Any]:
    """Nodal values as expressions of the unknowns ``x[i]``, plain numbers where they are fixed."""
    index, scale, offset = (a[component].tolist() for a in (field.index, field.scale, field.offset))
    return [
        o if i < 0 else o + s * x[i] if o else s * x[i] for i, s, o in zip(index, scale, offset, strict=True)
    ]


def source_61(x: Any, y: Any, sin: Callable[[Any], Any], choose: Callable[[Any, Any, Any], Any]) -> Any:
    """-Laplace of the exact solution (6.2), differentiated by hand."""
    a, pi = 0.5 - y, np.pi
    lower = 200 * sin(2 * pi * x) * (4 * pi**2 * y * a**4 + 8 * a**3 - 12 * y * a**2)
    upper = 100 * sin(pi / 2 * x) * (pi**2 / 4 * (1 - y) * a**4 - 8 * a**3 - 12 * (1 - y) * a**2)
    return choose(y <= 0.5, lower, upper)


def energy_61(program: Program, x: Any, sin: Any, choose: Any) -> tuple[Any, list[Any]]:
    """The energy of Example 6.1, element by element with the midpoint rule, and the nodal displacements."""
    X, Y = (entries(program.positions, i, x) for i in (0, 1))
    u = entries(program.displacement, 0, x)
    terms = []
    for a, b, c in program.triangles.tolist():
        x1, x2, y1, y2 = X[b] - X[a], X[c] - X[a], Y[b] - Y[a], Y[c] - Y[a]
        det, u1, u2 = x1 * y2 - x2 * y1, u[b] - u[a], u[c] - u[a]
        strain = ((y2 * u1 - y1 * u2) ** 2 + (x1 * u2 - x2 * u1) ** 2) / (4 * det)
        work = sum(
            source_61((X[i] + X[j]) / 2, (Y[i] + Y[j]) / 2, sin, choose) * (u[i] + u[j]) / 2
            for i, j in ((a, b), (b, c), (c, a))
        )
        terms.append(strain - det / 6 * work)
    return sum(terms), u


def ours_joint(case: Case) -> Finish:
    """Our strategy ``joint``."""
    solution = joint.solve(case.problem, time_limit_s=min(case.limit, 1e6))
    return Finish(np.asarray(solution.mesh.p), solution.status.value, solution.wall_time_s)


def nlpsol_mapped(case: Case) -> Finish:
    """Our expressions, all derivatives left to ``nlpsol``."""
    program = program_of(case.problem)
    began = time.perf_counter()
    rel = relocation(case.problem)
    plain = replace(rel.nlp, derivatives=None)
    result = Solver(plain, options=program.ipopt(case.limit))(program.start)
    seconds = time.perf_counter() - began
    return Finish(rel.nodes(rel.split(result.x)[0]), result.status.value, seconds)


def nlpsol_written_out(case: Case) -> Finish:
    """What one writes first in CasADi: a sum over the elements, handed to ``nlpsol``."""
    program = program_of(case.problem)
    began = time.perf_counter()
    x = ca.SX.sym("x", program.start.size)
    energy, u = energy_61(program, ca.vertsplit(x), ca.sin, ca.if_else)
    gaps = ca.vertcat(*[u[i] for i in program.contact])
    settings = {"ipopt": program.ipopt(case.limit), "print_time": False, "error_on_fail": False}
    solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": energy, "g": gaps}, settings)
    answer = solver(x0=program.start, lbx=-program.bound, ubx=program.bound, lbg=0, ubg=np.inf)
    seconds = time.perf_counter() - began
    status = "converged" if solver.stats()["success"] else solver.stats()["return_status"]
    return Finish(program.nodes(answer["x"].full().ravel()), status, seconds)


def pyomo_model(case: Case) -> Finish:
    """The same sum over the elements in Pyomo, solved by an ``ipopt`` executable, or through cyipopt."""
    import pyomo.environ as pyo

    program = program_of(case.problem)
    began = time.perf_counter()
    model = pyo.ConcreteModel()
    model.x = pyo.Var(
        range(program.start.size),
        initialize=lambda _, i: float(program.start[i]),
        bounds=lambda _, i: (-program.bound[i], program.bound[i]) if np.isfinite(program.bound[i]) else None,
    )
    energy, u = energy_61(
        program, model.x, pyo.sin, lambda test, yes, no: pyo.Expr_if(IF=test, THEN=yes, ELSE=no)
    )
    model.energy = pyo.Objective(expr=energy)
    model.gap = pyo.Constraint(range(len(program.contact)), rule=lambda _, k: u[program.contact[k]] >= 0)
    solver, options = pyo.SolverFactory("ipopt"), program.ipopt(case.limit)
    if solver.available(exception_flag=False):
        solver.options.update(options)
    else:
        solver = pyo.SolverFactory("cyipopt")
        if not solver.available(exception_flag=False):
            raise RuntimeError("no ipopt executable, and no cyipopt with PyNumero's library")
        solver.config.options = options
    result = solver.solve(model, load_solutions=True)
    seconds = time.perf_counter() - began
    condition = str(result.solver.termination_condition)
    x = [pyo.value(model.x[i]) for i in range(program.start.size)]
    return Finish(program.nodes(x), "converged" if condition == "optimal" else condition, seconds)


# ---------------------------------------------------------------- nested: a contact solve per evaluation


def ours_nested(outer: str) -> Callable[[Case], Finish]:
    """Our strategy ``nested`` with a second-order outer solver, its build included."""

    def run(case: Case) -> Finish:
        began = time.perf_counter()
        ReducedEnergy(relocation(case.problem))
        build = time.perf_counter() - began
        solution = nested.solve(case.problem, outer=outer)
        return Finish(np.asarray(solution.mesh.p), solution.status.value, build + solution.wall_time_s)

    return run


def scipy_minimize(method: str, derivative: str) -> Callable[[Case], Finish]:
    """``scipy.optimize.minimize`` on the reduced energy, with SciPy's finite differences or our gradient."""

    def run(case: Case) -> Finish:
        began = time.perf_counter()
        reduced = ReducedEnergy(relocation(case.problem))
        bound = reduced.relocation.freedoms.bound
        start = np.zeros(bound.size)
        value = _values(reduced) if derivative == "2-point" else lambda q: reduced(q).value
        unit = abs(value(start)) or 1.0
        best, lowest = start, np.inf

        def objective(q: Array) -> float:
            nonlocal best, lowest
            if time.perf_counter() - began > case.limit:
                raise OutOfTimeError
            found = value(q)
            if found < lowest:
                best, lowest = q.copy(), found
            return found / unit

        try:
            result = minimize(
                objective,
                start,
                jac="2-point" if derivative == "2-point" else lambda q: reduced(q).gradient / unit,
                method=method,
                bounds=Bounds(-bound, bound),
                tol=NestedSettings().scipy_tol,
                options={"maxiter": 500},
            )
            q, status = result.x, "converged" if result.success else str(result.message)
        except OutOfTimeError:
            q, status = best, f"stopped after {case.limit:g} s"
        seconds = time.perf_counter() - began
        return Finish(reduced.relocation.nodes(np.clip(q, -bound, bound)), status, seconds)

    return run


def _values(reduced: ReducedEnergy) -> Callable[[Array], float]:
    """The reduced energy without its gradient, warm-started as well."""
    active: ActiveSet | None = None

    def value(q: Array) -> float:
        nonlocal active
        equilibrium = solve(reduced.model.system(reduced.relocation.nodes(q)), active)
        active = equilibrium.active
        return equilibrium.energy

    return value


# ---------------------------------------------------------------- a plate with a hole


def plate(mesh: Path) -> ContactProblem:
    """The stretched plate of ``scripts/gallery/plate_with_hole.py`` on a given mesh."""
    name = {key: f"boundary-{tag}" for key, tag in PLATE.items()}
    pinned = tuple(name[side] for side in ("bottom", "right", "top", "left", "hole"))
    return ContactProblem(
        mesh=read_mesh(mesh),
        law=PlaneStrain(lame_lambda=1.25, lame_mu=1.0),
        dirichlet=(name["bottom"], Dirichlet(name["top"], (0.0, 1.0))),
        motion=Motion(None, pinned=pinned, min_area_fraction=0.01),
        name="plate",
    )


def neurom(case: Case) -> Finish:
    """NeuROM-Py: positions and displacement trained together by the L-BFGS of PyTorch, in double precision.

    Stopping rule and line search are those of its own example of the plate.
    """
    arguments, sys.argv = sys.argv, sys.argv[:1]  # its import parses the command line
    import torch
    from neurom.HiDeNN_PDE import MeshNN_2D
    from neurom.src import Pre_processing
    from neurom.src.Training import Training_2_3D_FEM

    sys.argv = arguments
    assert case.mesh is not None
    sides = [PLATE[side] for side in ("bottom", "right", "top", "left", "hole")]
    held = [
        {"Entity": PLATE[side], "Value": value, "Normal": i, "Relation": False, "Constitutive": False}
        for side, values in (("bottom", (0, 0)), ("top", (0, 1)))
        for i, value in enumerate(values)
    ]
    config = {
        "training": {"n_epochs": EPOCHS, "multiscl_max_refinment": 1, "optimizer": "lbfgs"},
        "interpolation": {"MaxElemSize2D": 0.5},
        "solver": {"TrainingStrategy": "Integral", "volume_forces": False, "regul_term": False},
        "postprocess": {"ModularEpochsPrint": 10},
    }
    mesh_file = case.mesh.resolve()
    home = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # it reads and writes in fixed folders
        os.mkdir("Geometries")
        shutil.copyfile(mesh_file, "Geometries/plate_order_1_0.5.msh")
        began = time.perf_counter()
        mesh = Pre_processing.Mesh("plate", 0.5, 1, 2, welcome=False)
        mesh.AddBorders(sides)
        mesh.AddBCs(PLATE["body"], [], held)
        mesh.MeshGeo()
        mesh.ReadMesh()
        mesh.ExportMeshVtk()
        given = np.array(mesh.Nodes)[:, 1:3]
        model = MeshNN_2D(mesh, n_components=2)
        model.UnFreeze_FEM()
        model.to(torch.float64)
        model.UnFreeze_Mesh()
        model.RefinementParameters(MaxGeneration=1, Jacobian_threshold=0.3)
        model.TrainingParameters(loss_decrease_c=1e-7, Max_epochs=EPOCHS, learning_rate=0.001)
        model = Training_2_3D_FEM(model, config, Pre_processing.Material(True, 1.25, 1.0))
        seconds = time.perf_counter() - began
        os.chdir(home)
    moved = given.copy()
    moved[model.coord_free.numpy()] = model.coordinates["free"].detach().numpy()
    p = np.asarray(case.problem.mesh.p).T
    order = np.argmin(np.abs(p[:, None] - given[None]).sum(axis=2), axis=1)
    ended = len(model.training_recap["Loss_tot"]) < EPOCHS
    status = "converged" if ended else "iteration_limit"
    return Finish(np.ascontiguousarray(moved[order].T), status, seconds)


# ---------------------------------------------------------------- MPCCs


def ours_mpcc(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """Our MPCC solver."""
    result = mpcc.solve(as_mpcc(problem), problem["x0"])
    return result.x, result.status.value


def scholtes_loop(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """The plain loop of ``benchmark_mpcc.py``."""
    answer = plain_loop_result(problem)
    return answer["x"].full().ravel(), "ended"


def mpecss(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """MPECSS, given the problem in its own file format."""
    from mpecss.helpers.loaders.macmpec_loader import load_macmpec
    from mpecss.phase_2.mpecss import run_mpecss

    def bounds(key: str) -> list[float | None]:
        return [float(b) if np.isfinite(b) else None for b in problem[key]]

    n = int(problem["G"].shape[0])
    data: dict[str, Any] = {"w0": list(map(float, problem["x0"])), "lbG": [0.0] * n, "lbH": [0.0] * n}
    data |= {"lbw": bounds("lbx"), "ubw": bounds("ubx"), "lbg": bounds("lbg"), "ubg": bounds("ubg")}
    for key in ("f", "g", "G", "H"):
        if problem[key].shape[0]:
            data[f"{key}_fun"] = ca.Function(key, [problem["x"]], [problem[key]]).serialize()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{Path(folder).name}.nl.json"  # what it has built is kept by name
        path.write_text(json.dumps(data), encoding="utf-8")
        result = run_mpecss(load_macmpec(str(path)), z0=np.array(problem["x0"], dtype=float))
    return np.asarray(result["z_final"]), str(result["status"])


def pympcc(problem: Mapping[str, Any]) -> tuple[Array, str]:
    """The package pympcc with its default strategy and the exact derivatives that CasADi gives."""
    import pympcc as peer

    x, g, G, H = problem["x"], problem["g"], problem["G"], problem["H"]
    lower, upper = (np.asarray(problem[key], dtype=float) for key in ("lbg", "ubg"))
    equal = lower == upper
    h = ca.vertcat(*[g[int(i)] - lower[i] for i in np.flatnonzero(equal)], ca.SX(0, 1))
    below = [lower[i] - g[int(i)] for i in np.flatnonzero(~equal & np.isfinite(lower))]
    above = [g[int(i)] - upper[i] for i in np.flatnonzero(~equal & np.isfinite(upper))]
    c = ca.vertcat(*below, *above, ca.SX(0, 1))
    rows = ca.vertcat(c, h, G, H, G * H)
    weights, weight = ca.SX.sym("weights", rows.shape[0]), ca.SX.sym("weight")
    hessian = ca.tril(ca.hessian(weight * problem["f"] + ca.dot(weights, rows), x)[0])
    hessian_at = ca.Function("hessian", [x, weights, weight], [hessian])

    def dense(expression: Any) -> Callable[[Array], Array]:
        function = ca.Function("f", [x], [expression])
        return lambda at: function(at).full()

    def column(expression: Any) -> Callable[[Array], Array]:
        function = dense(expression)
        return lambda at: function(at).ravel()

    def lagrangian(at: Array, multipliers: Array, factor: float) -> Array:
        padded = np.zeros(rows.shape[0])
        padded[: min(len(multipliers), len(padded))] = multipliers[: len(padded)]
        return np.array(hessian_at(at, padded, factor).nonzeros())

    value = column(problem["f"])
    derivatives = {
        "gradient": column(ca.gradient(problem["f"], x)),
        "comp_G": column(G),
        "comp_G_jacobian": dense(ca.jacobian(G, x)),
        "comp_H": column(H),
        "comp_H_jacobian": dense(ca.jacobian(H, x)),
        "lagrangian_hessian": lagrangian,
        "lagrangian_hessian_sparsity": tuple(np.array(part) for part in hessian.sparsity().get_triplet()),
    }
    if c.shape[0]:
        derivatives |= {"ineq_constraints": column(c), "ineq_jacobian": dense(ca.jacobian(c, x))}
    if h.shape[0]:
        derivatives |= {"eq_constraints": column(h), "eq_jacobian": dense(ca.jacobian(h, x))}
    stated = peer.MPCCProblem(
        n=x.shape[0],
        n_comp=G.shape[0],
        x0=np.array(problem["x0"], dtype=float),
        objective=lambda at: float(value(at)[0]),
        xl=np.array(problem["lbx"], dtype=float),
        xu=np.array(problem["ubx"], dtype=float),
        n_ineq=c.shape[0],
        n_eq=h.shape[0],
        **derivatives,
    )
    result = peer.solve(stated)
    return np.asarray(result.x), "converged" if result.success else "not converged"


# ---------------------------------------------------------------- running one of them

Relocate = Callable[[Case], Finish]
SolveMpcc = Callable[[Mapping[str, Any]], tuple[Array, str]]

JOINT: dict[str, Relocate] = {
    "rmesh_nlp joint": ours_joint,
    "CasADi nlpsol, written out": nlpsol_written_out,
    "CasADi nlpsol, our expressions": nlpsol_mapped,
    "Pyomo, Ipopt": pyomo_model,
}
NESTED: dict[str, Relocate] = {
    f"rmesh_nlp nested, {outer}": ours_nested(outer) for outer in ("newton", "newton-pair")
} | {
    f"SciPy {method}, {name}": scipy_minimize(method, derivative)
    for derivative, name in (("gradient", "our gradient"), ("2-point", "finite differences"))
    for method in ("SLSQP", "trust-constr", "L-BFGS-B")
}
PLATES: dict[str, Relocate] = {"rmesh_nlp joint": ours_joint, "NeuROM-Py": neurom}
MPCCS: dict[str, SolveMpcc] = {
    "rmesh_nlp.mpcc": ours_mpcc,
    "plain Scholtes loop on nlpsol": scholtes_loop,
    "MPECSS": mpecss,
    "pympcc": pympcc,
}
GROUPS: dict[str, Mapping[str, Any]] = {"joint": JOINT, "nested": NESTED, "plate": PLATES, "mpcc": MPCCS}
"""Solvers by group, ours first."""


def judged(problem: ContactProblem, finish: Finish) -> Answer:
    """Energy of an exact contact solve and least element area over its initial value."""
    areas = signed_areas(finish.nodes, problem.triangles) / signed_areas(problem.mesh.p, problem.triangles)
    least = float(np.min(areas))
    energy = ContactModel(problem).solve(finish.nodes).energy if least > 0 else None
    return Answer(finish.status, finish.seconds, energy=energy, least_area=least)


def is_solved(problem: Mapping[str, Any], x: Array) -> bool:
    """Whether a point is at the target, feasible and complementary."""
    expressions = [problem[key] for key in ("f", "g", "G", "H")]
    values = ca.Function("all", [problem["x"]], expressions)(x)
    f, g, G, H = (np.asarray(value.full()).ravel() for value in values)
    bounds = (np.asarray(problem[key], dtype=float) for key in ("lbx", "ubx", "lbg", "ubg"))
    lbx, ubx, lbg, ubg = bounds
    excess = np.concatenate([lbx - x, x - ubx, lbg - g, g - ubg, -G, -H, np.minimum(G, H)])
    error = relative_error(float(f[0]), problem["target"])
    return bool(error <= REACHED and np.max(excess) <= FEASIBLE)


def mpcc_answers(solver: SolveMpcc, collection: Path, skip: int, limit: float) -> Iterator[Answer]:
    """One answer per problem of a collection, without the first ``skip``.

    A problem that takes longer than ``limit`` ends the process by a signal, also inside compiled code.
    """
    module = load(collection)
    warm = ca.SX.sym("warm")
    ca.nlpsol("warm", "ipopt", {"x": warm, "f": warm**2}, SILENT)(x0=1)
    for name in module.names()[skip:]:
        problem = module.get(name)
        signal.setitimer(signal.ITIMER_REAL, limit if np.isfinite(limit) else 0)
        began = time.perf_counter()
        try:
            x, status = solver(problem)
        except Exception as error:  # a peer's failure is a result
            seconds = time.perf_counter() - began
            yield Answer(type(error).__name__, seconds, failed=True, solved=False)
            continue
        seconds = time.perf_counter() - began
        signal.setitimer(signal.ITIMER_REAL, 0)
        yield Answer(status, seconds, solved=is_solved(problem, x))


def answers(options: argparse.Namespace) -> Iterator[Answer]:
    """What one solver gives."""
    group, name = options.solver.split("/", 1)
    solver = GROUPS[group][name]
    if group == "mpcc":
        yield from mpcc_answers(solver, options.collection, options.skip, options.limit)
        return
    mesh = options.plate if group == "plate" else None
    problem = EXAMPLES["6.1"](options.n) if mesh is None else plate(mesh)
    warm = ours_joint if mesh is not None else solver
    warm(Case(EXAMPLES["6.1"](3)))
    yield judged(problem, solver(Case(problem, mesh, options.limit)))


def main() -> None:
    """Run one solver and write its answers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("solver", help="GROUP/NAME")
    parser.add_argument("--n", type=int, default=8, help="squares per side of Example 6.1")
    parser.add_argument("--plate", type=Path)
    parser.add_argument("--collection", type=Path)
    parser.add_argument("--skip", type=int, default=0)
    parser.add_argument("--limit", type=float, default=float("inf"))
    parser.add_argument("--answer", type=Path, required=True)
    options = parser.parse_args()
    with options.answer.open("w", encoding="utf-8") as file:
        for answer in answers(options):
            print(json.dumps(asdict(answer)), file=file, flush=True)


if __name__ == "__main__":
    main()
