r"""The formulations against each other and against what people would use instead, in one run.

    python scripts/benchmark_peers.py                           all (half an hour)
    python scripts/benchmark_peers.py --groups examples peers --repeat 1

Groups: the paper's examples, and Example 6.1 refined, by every formulation; relaxations of ``mpcc``; an
objective for which the two levels differ; and Example 6.1 beside plain CasADi and SciPy. Move limits are the
paper's, in proportion to the mesh width. Every solve is a process of its own that keeps nothing of another
one; solvers take turns, so that a busy machine slows all alike. Time is processor time of build and solve
without the assessment, median and range of the runs. Energies are of a contact solve on the final mesh by
the problem's own rule. Writes DIR/formulations.md and DIR/rows.jsonl.

The peers of ``benchmark_mpcc.py`` are installed by ``pip install mpecss pympcc``. cyipopt, which pympcc
needs, is built against the Ipopt in CasADi's wheel, and so is the very Ipopt that ours uses::

    C=$(python -c "import casadi; print(casadi.__path__[0])")
    CFLAGS="-I$C/include/coin-or" LDFLAGS="-L$C -Wl,-rpath,$C" PKG_CONFIG_PATH=$C/pkgconfig \
        pip install cyipopt
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

import rmesh_nlp as rm
from best_mesh.methods import unassessed
from isolated import Failed, isolated
from peer_solvers import End, nlpsol_mapped, nlpsol_written_out, scipy_minimize
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.problem import ContactProblem, signed_areas
from rows import Row, Store, command_line, figure, markdown, timed

LONG = 20.0
"""Seconds from which on a solve is not repeated."""

PATIENCE = 6
"""Times the limit, by the clock, after which a process is ended: others may use the machine."""

Solver = Callable[[ContactProblem, str, float], End]
"""Of a problem, what is minimised, and the seconds it may take."""


def ours(problem: ContactProblem, objective: str, limit: float, formulation: str, **settings: str) -> End:
    """One of our formulations; the assessment is no part of its time."""
    limits = rm.Limits(limit)
    solution, seconds = timed(rm.solve, problem, formulation, objective=objective, limits=limits, **settings)
    status = solution.status.value if solution.success else f"{solution.status.value}, no success"
    value = None if objective == "energy" else solution.record()["objective_value"]
    nodes = np.asarray(solution.mesh.p)
    return End(nodes, status, unassessed(seconds, solution), solution.iterations, value)


FORMULATIONS: Mapping[str, Solver] = {
    name: partial(ours, formulation=name) for name in ("joint", "mpcc", "nested")
}
OTHERS: Mapping[str, Solver] = {
    f"mpcc, {name}": partial(ours, formulation="mpcc", relaxation=name)
    for name in RELAXATIONS
    if name != "scholtes"
}
PEERS: Mapping[str, Solver] = {
    "CasADi nlpsol, our expressions": nlpsol_mapped,
    "CasADi nlpsol, written out": nlpsol_written_out,
    "SciPy L-BFGS-B, our gradient": partial(scipy_minimize, method="L-BFGS-B"),
    "SciPy trust-constr, our gradient": partial(scipy_minimize, method="trust-constr"),
    "SciPy SLSQP, our gradient": partial(scipy_minimize, method="SLSQP"),
}


@dataclass(frozen=True)
class Task:
    """A problem, what is minimised, and who solves it; times are compared with the first of them."""

    name: str
    problem: Callable[[], ContactProblem]
    solvers: Mapping[str, Solver]
    objective: str = "energy"


def _refined(sizes: Sequence[int], what: str, solvers: Mapping[str, Solver], *objective: str) -> list[Task]:
    return [Task(f"6.1, n = {n}{what}", partial(EXAMPLES["6.1"], n), solvers, *objective) for n in sizes]


WITHOUT_ENERGY = {name: FORMULATIONS[name] for name in ("nested", "mpcc")}
BESIDE_PEERS = {name: FORMULATIONS[name] for name in ("joint", "nested")} | PEERS
GROUPS: Mapping[str, Sequence[Task]] = {
    "examples": [
        *_refined([8], "", FORMULATIONS | OTHERS),
        *(Task(name, EXAMPLES[name], FORMULATIONS | OTHERS) for name in ("6.2", "6.3")),
    ],
    "refined": _refined([16, 32, 64], "", FORMULATIONS),
    "objective": _refined([8, 16], ", error-l2", WITHOUT_ENERGY, "error-l2"),
    "peers": _refined([8, 16], ", peers", BESIDE_PEERS),
}


def run(task: Task, solver: str, limit: float) -> Row:
    """Solve once in a process of its own, and measure where it stopped by our own contact solve."""

    def work() -> Row:
        problem = task.problem()
        end = task.solvers[solver](problem, task.objective, limit)
        areas = (signed_areas(nodes, problem.triangles) for nodes in (end.nodes, problem.mesh.p))
        least, value = float(np.min(np.divide(*areas))), end.value
        if value is None and least > 0:
            value = float(ContactSolver(problem).solve(end.nodes).energy)
        ending = {"status": end.status, "value": value, "least area": least}
        return ending | {"iterations": end.iterations, "seconds": end.seconds}

    row = isolated(work, PATIENCE * limit)
    row = {"status": row.why} if isinstance(row, Failed) else row
    return {"problem": task.name, "solver": solver, **row}


def runs(task: Task, repeat: int, limit: float) -> Iterator[Row]:
    """All solvers of a task in turn; what took long, or failed, once."""
    done: set[str] = set()
    for _ in range(repeat):
        for solver in (name for name in task.solvers if name not in done):
            row = run(task, solver, limit)
            if row.get("seconds", np.inf) > LONG:
                done.add(solver)
            yield row


def table(rows: Sequence[Row]) -> str:
    """A line for each solver on each problem, in Markdown; ratios of times are medians, run by run."""
    columns = ["problem", "solver", "status", "value", "least area", "iterations", "seconds"]
    frame, lines = pd.DataFrame(rows, columns=columns), []
    for problem, of_problem in frame.groupby("problem", sort=False):
        first = of_problem[of_problem.solver == of_problem.solver.iloc[0]].seconds.to_numpy()
        for solver, own in of_problem.groupby("solver", sort=False):
            seconds, last = own.seconds.to_numpy(), own.iloc[-1]
            both = min(seconds.size, first.size)
            low, middle, high = (f"{np.quantile(seconds, q):.2g}" for q in (0, 0.5, 1))
            time = f"{middle} ({low} to {high})" if seconds.size > 1 else middle
            lines.append(
                {
                    "problem": problem,
                    "solver": solver,
                    "status": last.status[:60],
                    "energy, error": f"{last.value:.7g}",
                    "least area": f"{last['least area']:.2g}",
                    "iterations": f"{last.iterations:.0f}",
                    "time [s]": time,
                    "over the first": f"{np.median(seconds[:both] / first[:both]):.2g}",
                }
            )
    return markdown(pd.DataFrame(lines).replace("nan", None))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 if each of our formulations succeeded."""
    parser = command_line(__doc__, out="results/peers")
    parser.add_argument("--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS))
    parser.add_argument("--largest", type=int, default=64, help="squares a side up to which 6.1 is refined")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds that a solver may take")
    options = parser.parse_args(arguments)
    for solver in FORMULATIONS.values():  # loading libraries is nobody's cost
        solver(EXAMPLES["6.1"](3), "energy", options.limit)
    path = options.out / "rows.jsonl"
    path.unlink(missing_ok=True)
    store = Store(path)
    for task in (task for group in options.groups for task in GROUPS[group]):
        if task.problem().mesh.p.shape[1] > (options.largest + 1) ** 2:
            continue
        for row in runs(task, options.repeat, options.limit):
            store.add(row)
            print(*map(figure, row.values()), sep="; ", flush=True)
    text = table(store.rows)
    (options.out / "formulations.md").write_text(text, encoding="utf-8")
    print(text)
    own = [row for row in store.rows if row["solver"] in FORMULATIONS]
    return 0 if all("no success" not in row["status"] and row.get("value") is not None for row in own) else 1


if __name__ == "__main__":
    raise SystemExit(main())
