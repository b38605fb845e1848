"""Example 6.1 by our formulations beside what people would use instead: plain CasADi, and SciPy.

    python scripts/benchmark_peers.py
    python scripts/benchmark_peers.py --sizes 8 --repeat 1

Formulations and relaxations are compared with each other by ``rmesh compare --repeats 5 --verbose``. Every
solve is a process of its own that keeps nothing of another one; solvers take turns, so that a busy machine
slows all alike. Time is processor time of build and solve without the assessment, median and range of the
runs. Energies are of a contact solve on the final mesh by the problem's own rule. Writes DIR/table.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pandas as pd
from scipy.optimize import Bounds, minimize

import rmesh_nlp as rm
from best_mesh.cases import source_61
from best_mesh.methods import unassessed
from formulations import joint
from isolated import Failed, isolated
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.optimize.solver import IPOPT_OPTIONS, Solver
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.solving.outer import Outer
from rows import Row, command_line, markdown, timed

LONG = 20.0
"""Seconds from which on a solve is not repeated."""

PATIENCE = 6
"""Times the limit, by the clock, after which a process is ended: others may use the machine."""

TOLERANCE = 1e-8
"""Of SciPy's solvers."""


@dataclass(frozen=True)
class End:
    """Positions (2, nodes), the solver's own word, processor seconds of build and solve, and iterations."""

    nodes: Array
    status: str
    seconds: float
    iterations: int | None = None


def ours(problem: ContactProblem, limit: float, formulation: str) -> End:
    """One of our formulations; the assessment is no part of its time."""
    solution, seconds = timed(rm.solve, problem, formulation, limits=rm.Limits(limit))
    status = solution.status.value if solution.success else f"{solution.status.value}, no success"
    return End(np.asarray(solution.mesh.p), status, unassessed(seconds, solution), solution.iterations)


def start_of_joint(problem: ContactProblem, limit: float) -> tuple[Array, dict[str, Any]]:
    """Where ``joint`` starts, ``x = (q, u)``, and what it gives Ipopt: so every peer that uses it."""
    outer = Outer.of(problem)
    q = np.zeros(outer.relocation.n_q)
    unit = joint.pull(outer.energy(q).gradient)
    options = {**IPOPT_OPTIONS, **joint.Joint().options(areas=False, unit=unit), "max_wall_time": limit}
    return outer.energy.unknowns(q, outer.contact.given.u), options


def nlpsol_mapped(problem: ContactProblem, limit: float) -> End:
    """Our expressions, all derivatives left to ``nlpsol``."""
    start, options = start_of_joint(problem, limit)

    def work() -> tuple[Array, str]:
        rel = relocation(problem)
        result = Solver(replace(rel.nlp, derivatives=None), options=options)(start)
        return rel.nodes(rel.split(result.x)[0]), result.status.value

    (nodes, status), seconds = timed(work)
    return End(nodes, status, seconds)


def nlpsol_written_out(problem: ContactProblem, limit: float) -> End:
    """What one writes first in CasADi: a sum over the elements, handed to ``nlpsol``."""
    start, options = start_of_joint(problem, limit)
    rel = Outer.of(problem).relocation
    bound, positions = rel.nlp.ubx, rel.mesh_map.positions

    def work() -> tuple[Array, str]:
        x = ca.SX.sym("x", start.size)
        unknowns = ca.vertsplit(x)
        u = entries(rel.displacement, 0, unknowns)
        energy = energy_61(problem, *(entries(positions, i, unknowns) for i in (0, 1)), u)
        gaps = ca.vertcat(*[u[i] for i in problem.contact_nodes])
        settings = {"ipopt": options, "print_time": False, "error_on_fail": False}
        solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": energy, "g": gaps}, settings)
        answer = solver(x0=start, lbx=-bound, ubx=bound, lbg=0, ubg=np.inf)
        status = "converged" if solver.stats()["success"] else solver.stats()["return_status"]
        return positions.values(np.clip(answer["x"].full().ravel(), -bound, bound)), status

    (nodes, status), seconds = timed(work)
    return End(nodes, status, seconds)


def energy_61(problem: ContactProblem, x: list[Any], y: list[Any], u: list[Any]) -> Any:
    """The energy of Example 6.1, element by element with the midpoint rule, of nodal positions and values."""
    terms = []
    for a, b, c in problem.triangles.T.tolist():
        x1, x2, y1, y2 = x[b] - x[a], x[c] - x[a], y[b] - y[a], y[c] - y[a]
        det, u1, u2 = x1 * y2 - x2 * y1, u[b] - u[a], u[c] - u[a]
        strain = ((y2 * u1 - y1 * u2) ** 2 + (x1 * u2 - x2 * u1) ** 2) / (4 * det)
        work = sum(
            source_61((x[i] + x[j]) / 2, (y[i] + y[j]) / 2, ca.sin, ca.if_else) * (u[i] + u[j]) / 2
            for i, j in ((a, b), (b, c), (c, a))
        )
        terms.append(strain - det / 6 * work)
    return sum(terms)


def entries(field: Field, component: int, x: Any) -> list[Any]:
    """Nodal values as expressions of the unknowns ``x[i]``, plain numbers where they are fixed."""
    index, scale, offset = (a[component].tolist() for a in (field.index, field.scale, field.offset))
    return [
        o if i < 0 else o + s * x[i] if o else s * x[i] for i, s, o in zip(index, scale, offset, strict=True)
    ]


def scipy_minimize(problem: ContactProblem, limit: float, method: str) -> End:
    """``scipy.optimize.minimize`` on the reduced energy with our gradient: a contact solve per evaluation."""
    began = time.process_time()
    reduced = ReducedEnergy(ContactSolver(problem))
    bound = reduced.relocation.mesh_map.upper
    best, lowest = np.zeros(bound.size), np.inf
    unit = abs(reduced(best).value) or 1.0

    def energy(q: Array) -> float:
        nonlocal best, lowest
        if time.process_time() - began > limit:
            raise TimeoutError
        value = reduced(q).value
        if value < lowest:
            best, lowest = q.copy(), value
        return value / unit

    how = {"jac": lambda q: reduced(q).gradient / unit, "bounds": Bounds(-bound, bound), "tol": TOLERANCE}
    try:
        result = minimize(energy, best, method=method, options={"maxiter": 500}, **how)
        q, status = result.x, "converged" if result.success else str(result.message)
    except TimeoutError:
        q, status = best, f"stopped after {limit:g} s"
    seconds = time.process_time() - began
    return End(reduced.relocation.nodes(np.clip(q, -bound, bound)), status, seconds)


SOLVERS: Mapping[str, Callable[[ContactProblem, float], End]] = {
    "joint": partial(ours, formulation="joint"),
    "nested": partial(ours, formulation="nested"),
    "CasADi nlpsol, our expressions": nlpsol_mapped,
    "CasADi nlpsol, written out": nlpsol_written_out,
    "SciPy L-BFGS-B, our gradient": partial(scipy_minimize, method="L-BFGS-B"),
    "SciPy trust-constr, our gradient": partial(scipy_minimize, method="trust-constr"),
    "SciPy SLSQP, our gradient": partial(scipy_minimize, method="SLSQP"),
}
"""Of a problem, and the seconds that it may take; times are compared with the first."""


def run(n: int, solver: str, limit: float) -> Row:
    """Solve once in a process of its own, and measure where it stopped by our own contact solve."""

    def work() -> Row:
        problem = EXAMPLES["6.1"](n)
        end = SOLVERS[solver](problem, limit)
        areas = (signed_areas(nodes, problem.triangles) for nodes in (end.nodes, problem.mesh.p))
        least = float(np.min(np.divide(*areas)))
        energy = float(ContactSolver(problem).solve(end.nodes).energy) if least > 0 else np.nan
        ending = {"status": end.status, "energy": energy, "least area": least}
        return ending | {"iterations": end.iterations, "seconds": end.seconds}

    row = isolated(work, PATIENCE * limit)
    row = {"status": row.why} if isinstance(row, Failed) else row
    return {"problem": f"6.1, n = {n}", "solver": solver, **row}


def runs(n: int, repeat: int, limit: float) -> Iterator[Row]:
    """All solvers in turn; what took long, or failed, once."""
    done: set[str] = set()
    for _ in range(repeat):
        for solver in (name for name in SOLVERS if name not in done):
            row = run(n, solver, limit)
            if row.get("seconds", np.inf) > LONG:
                done.add(solver)
            yield row


def table(rows: Sequence[Row]) -> str:
    """A line for each solver on each problem, in Markdown; ratios of times are medians, run by run."""
    columns = ["problem", "solver", "status", "energy", "least area", "iterations", "seconds"]
    frame, lines = pd.DataFrame(rows, columns=columns), []
    for problem, of_problem in frame.groupby("problem", sort=False):
        first = of_problem[of_problem.solver == of_problem.solver.iloc[0]].seconds.to_numpy()
        for solver, own in of_problem.groupby("solver", sort=False):
            seconds, last = own.seconds.to_numpy(), own.iloc[-1]
            both = min(seconds.size, first.size)
            low, middle, high = (f"{np.quantile(seconds, q):.2g}" for q in (0, 0.5, 1))
            lines.append(
                {
                    "problem": problem,
                    "solver": solver,
                    "status": last.status[:60],
                    "energy": f"{last.energy:.7g}",
                    "least area": f"{last['least area']:.2g}",
                    "iterations": f"{last.iterations:.0f}",
                    "time [s]": f"{middle} ({low} to {high})" if seconds.size > 1 else middle,
                    "over the first": f"{np.median(seconds[:both] / first[:both]):.2g}",
                }
            )
    return markdown(pd.DataFrame(lines).replace("nan", None))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 if our formulations succeeded."""
    parser = command_line(__doc__, out="results/peers")
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16], help="squares a side")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds that a solver may take")
    options = parser.parse_args(arguments)
    ours(EXAMPLES["6.1"](3), options.limit, "joint")  # loading libraries is nobody's cost
    rows = [row for n in options.sizes for row in runs(n, options.repeat, options.limit)]
    text = table(rows)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "table.md").write_text(text, encoding="utf-8")
    print(text)
    own = [row["status"] for row in rows if row["solver"] in ("joint", "nested")]
    return 0 if set(own) == {"converged"} else 1


if __name__ == "__main__":
    raise SystemExit(main())
