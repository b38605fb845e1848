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

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np

from isolated import Failed, isolated
from peer_solvers import Case, Finish, nlpsol_mapped, nlpsol_written_out, scipy_minimize
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.report.columns import shown

Solver = Callable[[Case], Finish]
LONG = 20.0
"""Seconds from which on a solve is not repeated."""

PATIENCE = 6
"""Times the limit, by the clock, after which a process is ended: others may use the machine."""


def _by(formulation: str, **settings: object) -> Solver:
    return lambda case: case.solve(formulation, **settings)


FORMULATIONS: dict[str, Solver] = {name: _by(name) for name in ("joint", "mpcc", "nested")}
OTHERS: dict[str, Solver] = {
    f"mpcc, {name}": _by("mpcc", relaxation=name) for name in RELAXATIONS if name != "scholtes"
}
PEERS: dict[str, Solver] = {
    "CasADi nlpsol, our expressions": nlpsol_mapped,
    "CasADi nlpsol, written out": nlpsol_written_out,
    "SciPy L-BFGS-B, our gradient": scipy_minimize("L-BFGS-B"),
    "SciPy trust-constr, our gradient": scipy_minimize("trust-constr"),
    "SciPy SLSQP, our gradient": scipy_minimize("SLSQP"),
}


@dataclass(frozen=True)
class Task:
    """A problem, what is minimised, and who solves it; times are compared with the first of them."""

    name: str
    problem: Callable[[], ContactProblem]
    solvers: dict[str, Solver]
    objective: str = "energy"


def _paper(n: int) -> Callable[[], ContactProblem]:
    return lambda: EXAMPLES["6.1"](n)


GROUPS: dict[str, tuple[Task, ...]] = {
    "examples": (
        Task("6.1, n = 8", _paper(8), FORMULATIONS | OTHERS),
        Task("6.2", EXAMPLES["6.2"], FORMULATIONS | OTHERS),
        Task("6.3", EXAMPLES["6.3"], FORMULATIONS | OTHERS),
    ),
    "refined": tuple(Task(f"6.1, n = {n}", _paper(n), FORMULATIONS) for n in (16, 32, 64)),
    "objective": tuple(
        Task(
            f"6.1, n = {n}, error-l2", _paper(n), {k: FORMULATIONS[k] for k in ("nested", "mpcc")}, "error-l2"
        )
        for n in (8, 16)
    ),
    "peers": tuple(
        Task(f"6.1, n = {n}, peers", _paper(n), {k: FORMULATIONS[k] for k in ("joint", "nested")} | PEERS)
        for n in (8, 16)
    ),
}


@dataclass(frozen=True)
class Row:
    """One run; None where there is no such figure."""

    problem: str
    solver: str
    status: str
    value: float | None = None
    least_area: float | None = None
    iterations: int | None = None
    seconds: float | None = None


def run(task: Task, solver: str, limit: float) -> Row:
    """Solve once in a process of its own, and measure where it stopped by our own contact solve."""

    def work() -> Row:
        problem = task.problem()
        end = task.solvers[solver](Case(problem, task.objective, limit))
        given = signed_areas(problem.mesh.p, problem.triangles)
        least = float(np.min(signed_areas(end.nodes, problem.triangles) / given))
        value = end.value
        if value is None and least > 0:
            value = float(ContactSolver(problem).solve(end.nodes).energy)
        return Row(task.name, solver, end.status, value, least, end.iterations, end.seconds)

    found = isolated(work, PATIENCE * limit)
    return Row(task.name, solver, found.why) if isinstance(found, Failed) else found


def runs(task: Task, repeat: int, limit: float) -> Iterator[Row]:
    """All solvers of a task in turn; what took long, or failed, once."""
    done: set[str] = set()
    for _ in range(repeat):
        for solver in (name for name in task.solvers if name not in done):
            row = run(task, solver, limit)
            if row.seconds is None or row.seconds > LONG:
                done.add(solver)
            yield row


def table(rows: Sequence[Row]) -> str:
    """A line for each solver on each problem, in Markdown."""
    lines = [
        "| problem | solver | status | energy, error | least area | iterations | time [s] | over the first |",
        "|:--|:--|:--|--:|--:|--:|--:|--:|",
    ]
    first: list[float] = []
    for problem, solver in dict.fromkeys((row.problem, row.solver) for row in rows):
        own = [row for row in rows if (row.problem, row.solver) == (problem, solver)]
        seconds = [row.seconds for row in own if row.seconds is not None]
        if (problem, solver) == next((r.problem, r.solver) for r in rows if r.problem == problem):
            first = seconds
        last = own[-1]
        text, ratio = "-", "-"
        if seconds:
            spread = f" ({min(seconds):.2g} to {max(seconds):.2g})" if len(seconds) > 1 else ""
            text = f"{median(seconds):.2g}{spread}"
            ratios = [a / b for a, b in zip(seconds, first, strict=False)]
            ratio = f"{median(ratios):.2g}" if ratios else "-"
        lines.append(
            f"| {problem} | {solver} | {last.status.replace('|', '/')[:60]} | {shown(last.value, '.7g')} "
            f"| {shown(last.least_area, '.2g')} | {shown(last.iterations, 'd')} | {text} | {ratio} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 if each of our formulations succeeded."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS))
    parser.add_argument("--largest", type=int, default=64, help="squares a side up to which 6.1 is refined")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds that a solver may take")
    parser.add_argument("--out", type=Path, default=Path("results/peers"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    for solver in FORMULATIONS.values():  # loading libraries is nobody's cost
        solver(Case(EXAMPLES["6.1"](3)))
    rows: list[Row] = []
    with (options.out / "rows.jsonl").open("w", encoding="utf-8") as file:
        for task in (task for group in options.groups for task in GROUPS[group]):
            if task.problem().mesh.p.shape[1] > (options.largest + 1) ** 2:
                continue
            for row in runs(task, options.repeat, options.limit):
                rows.append(row)
                print(json.dumps(asdict(row)), file=file, flush=True)
                print(
                    f"{row.problem:24} {row.solver:36} {row.status:20} {row.seconds or 0:.3f} s", flush=True
                )
            (options.out / "formulations.md").write_text(table(rows), encoding="utf-8")
    print(table(rows))
    ours = [row for row in rows if row.solver in FORMULATIONS]
    return 0 if all("no success" not in row.status and row.value is not None for row in ours) else 1


if __name__ == "__main__":
    sys.exit(main())
