"""Cost of the strategies against the size of the mesh, counted in contact solves.

    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_scaling.py --out scaling
    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_scaling.py --out scaling --large

The unit of cost is one cold contact solve on the same mesh in the same process (median of five, or of as
many as fit into a third of a second).
Example 6.1 is refined with delta = 0.22/n and Example 6.3 with delta = h/4, so that a node may
move by the same part of its neighbourhood. For each strategy the table gives the time to 90 %
and 99 % of the best known gain and to its own end, in units, and seconds and memory of it all.
Seconds are of building and solving; the audit, which is the same for all, is left out.
The best known gain is the lower of what this table reaches and of the figures below.

Every solve is a process of its own and one row, also one that fails or is stopped at the limit.
Rows are kept in ``scaling.json``: what is there is not run again, so a run can be interrupted,
and ``--large`` adds the large meshes. Writes ``scaling.md`` and ``scaling.png`` after each row.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from multiprocessing.connection import Connection
from pathlib import Path

import matplotlib as mpl
import numpy as np

from support.formulations import joint, mpcc, nested
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.solution import Solution

mpl.use("Agg")
import matplotlib.pyplot as plt

BEST_KNOWN = Path(__file__).parents[1] / "docs" / "best_known.json"
"""Least energies of random starts, made by ``scripts/best_known.py``; grids that are not there are compared
with the least energy of this table."""

LONGEST = 600.0
"""Seconds of build and solve after which a strategy is asked to stop: then its row says how far it came."""

FEASIBLE = 1e-6
"""Constraint violation below which an iterate of an all-at-once strategy counts."""

PAIR = "nested, newton-pair"

STRATEGIES: dict[str, Callable[[ContactProblem], Solution]] = {
    PAIR: lambda problem: nested.solve(problem, outer="newton-pair", time_limit_s=LONGEST),
    "nested, newton": lambda problem: nested.solve(problem, outer="newton", time_limit_s=LONGEST),
    "nested, ipopt": lambda problem: nested.solve(problem, outer="ipopt", time_limit_s=LONGEST),
    "joint": lambda problem: joint.solve(problem, time_limit_s=LONGEST),
    "mpcc": lambda problem: mpcc.solve(problem, time_limit_s=LONGEST),
}

SIZES = {
    "6.1": {PAIR: (8, 16, 32, 64, 128), "nested, newton": (8, 16, 32, 64, 128), "nested, ipopt": (8, 16, 32),
            "joint": (8, 16, 32, 64), "mpcc": (8, 16, 32, 64)},
    "6.3": {PAIR: (12, 24, 48, 96), "nested, newton": (12, 24, 48, 96), "joint": (12, 24, 48),
            "mpcc": (12, 24, 48)},
}  # fmt: skip
LARGE = {"6.1": {PAIR: (224, 448), "joint": (128, 224)}, "6.3": {PAIR: (192,)}}
"""Squares along x_1; Example 6.3 has half as many along x_2."""


@dataclass(frozen=True)
class Case:
    """One solve."""

    example: str
    n: int
    strategy: str

    def problem(self) -> ContactProblem:
        """The refined example."""
        return EXAMPLES[self.example](self.n if self.example == "6.1" else (self.n, self.n // 2))


@dataclass(frozen=True)
class Row:
    """What one solve gave; seconds and the energies of its history, None where it did not get that far."""

    case: Case
    status: str
    nodes: int = 0
    unit: float | None = None
    initial: float | None = None
    energy: float | None = None
    iterations: int | None = None
    seconds: float | None = None
    gigabytes: float | None = None
    history: tuple[tuple[float, float], ...] = ()

    def units_to(self, share: float, best: float) -> float | None:
        """Contact solves until this share of the gain to ``best`` is there."""
        if self.unit is None or self.initial is None:
            return None
        target = self.initial - share * (self.initial - best)
        reached = (seconds for seconds, energy in self.history if energy <= target)
        found = next(reached, None)
        return None if found is None else found / self.unit


def unit_of_cost(problem: ContactProblem) -> float:
    """Seconds of one cold contact solve, the median of five or more."""
    model = ContactModel(problem)
    seconds: list[float] = []
    while len(seconds) < 5 or sum(seconds) < 0.3:
        began = time.perf_counter()
        model.solve(problem.mesh.p)
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds)


def solved(case: Case) -> Row:
    """Solve one case in this process."""
    problem = case.problem()
    unit = unit_of_cost(problem)
    solution = STRATEGIES[case.strategy](problem)
    feasible = [step for step in solution.history if not step.primal_residual > FEASIBLE]
    return Row(
        case,
        solution.status.value if solution.success else f"{solution.status.value}, no success",
        nodes=problem.mesh.p.shape[1],
        unit=unit,
        initial=solution.energy_initial,
        energy=solution.energy,
        iterations=solution.iterations,
        seconds=solution.build_time_s + solution.solve_time_s,
        gigabytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        history=tuple((step.seconds, step.energy) for step in feasible),
    )


def _child(case: Case, pipe: Connection) -> None:
    try:
        pipe.send(solved(case))
    except Exception as error:  # a strategy that fails is a row
        pipe.send(Row(case, f"{type(error).__name__}: {error}"[:80]))


def isolated(case: Case, limit: float) -> Row:
    """Solve one case in a process of its own, for at most ``limit`` seconds."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(case, there))
    process.start()
    there.close()
    try:
        row = here.recv() if here.poll(limit) else Row(case, f"stopped after {limit:.0f} s")
    except EOFError:
        row = Row(case, "the process died")
    process.kill()
    process.join()
    return row


def best_energies(rows: Sequence[Row]) -> dict[tuple[str, int], float]:
    """The least energy of each mesh."""
    rows_known = json.loads(BEST_KNOWN.read_text()) if BEST_KNOWN.exists() else []
    best = {(row["example"], row["n"]): float(row["energy"]) for row in rows_known}
    for row in rows:
        if row.energy is not None:
            key = (row.case.example, row.case.n)
            best[key] = min(best.get(key, np.inf), row.energy)
    return best


def exponent(rows: Sequence[Row], example: str, strategy: str) -> float | None:
    """Least-squares slope of log seconds over log nodes, n = 32 to 224."""
    points = [
        (np.log(r.nodes), np.log(r.seconds))
        for r in rows
        if (r.case.example, r.case.strategy) == (example, strategy)
        and 32 <= r.case.n <= 224
        and r.status == "converged"
    ]
    return float(np.polyfit(*zip(*points, strict=True), 1)[0]) if len(points) > 2 else None


def markdown(rows: Sequence[Row]) -> str:
    """The rows as Markdown tables, one per example."""

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.1f}" if value < 100 else f"{value:.0f}"

    best = best_energies(rows)
    lines = [
        f"Measured on {date.today()}, {os.cpu_count()} cores, {platform.machine()}, {platform.system()}."
    ]
    for example in dict.fromkeys(r.case.example for r in rows):
        lines += [
            "",
            f"Example {example} refined",
            "",
            "| n | strategy | status | energy | gain | iterations | to 90 % | to 99 % | all | unit [s] "
            "| all [s] | memory [GB] |",
            "|--:|:--|:--|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
        ]
        for r in sorted((r for r in rows if r.case.example == example), key=lambda r: r.case.n):
            head = f"| {r.case.n} | {r.case.strategy} | {r.status} "
            if r.unit is None or r.initial is None or r.energy is None or r.seconds is None:
                lines.append(head + "| - " * 9 + "|")
                continue
            least = best[(example, r.case.n)]
            gain = (r.initial - r.energy) / (r.initial - least)
            lines.append(
                f"{head}| {r.energy:.7f} | {100 * gain:.2f} % | {r.iterations} "
                f"| {number(r.units_to(0.9, least))} | {number(r.units_to(0.99, least))} "
                f"| {number(r.seconds / r.unit)} | {r.unit:.4f} | {r.seconds:.3g} | {r.gigabytes:.2f} |"
            )
        slopes = [
            f"{strategy} {slope:.2f}"
            for strategy in STRATEGIES
            if (slope := exponent(rows, example, strategy)) is not None
        ]
        if slopes:
            powers = ", ".join(slopes)
            lines += ["", f"Seconds grow with the number of nodes, n = 32 to 224, to the power: {powers}."]
    return "\n".join(lines)


def figure(rows: Sequence[Row], path: Path) -> None:
    """Cost to 99 % of the gain in contact solves, and seconds of it all, against the size; Example 6.1."""
    colours, markers = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7"), "vos^D"
    best = best_energies(rows)
    fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
    for strategy, colour, marker in zip(STRATEGIES, colours, markers, strict=True):
        here = [r for r in rows if (r.case.strategy, r.case.example) == (strategy, "6.1")]
        own = sorted((r for r in here if r.unit and "no success" not in r.status), key=lambda r: r.case.n)
        to_99 = [(r.case.n, r.units_to(0.99, best["6.1", r.case.n])) for r in own]
        reached = [(n, cost) for n, cost in to_99 if cost is not None]
        style = {"marker": marker, "color": colour, "label": strategy, "markersize": 5}
        if strategy == "mpcc":  # where it and joint cost the same, both are to be seen
            style |= {"markerfacecolor": "none", "markersize": 8, "linestyle": "--"}
        if reached:
            left.loglog(*zip(*reached, strict=True), **style)
        if own:
            right.loglog([r.nodes for r in own], [r.seconds for r in own], **style)
    sizes = sorted({r.case.n for r in rows if r.case.example == "6.1"})
    left.axhline(30, color="0.5", linestyle=":", linewidth=1)
    left.set_xticks(sizes, [str(n) for n in sizes])
    left.minorticks_off()
    left.set(xlabel="squares per side n", ylabel="to 99 % of the gain [contact solves]")
    left.set_yticks([10, 30, 100, 300], ["10", "30", "100", "300"])
    nodes = np.array([1e3, 2e5])
    right.loglog(nodes, 0.2 * (nodes / 1e3) ** 1.25, color="0.5", linestyle=":", linewidth=1)
    right.annotate("power 1.25", (6e3, 0.2 * 6**1.25), fontsize=8, color="0.4", ha="left", va="top")
    right.set(xlabel="nodes", ylabel="to the end [s]")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    right.legend(fontsize=8)
    fig.savefig(path, dpi=200)
    plt.close(fig)


def cases(
    large: bool, strategies: Sequence[str], examples: Sequence[str], sizes: Sequence[int] | None
) -> list[Case]:
    """What to run, the small meshes first."""
    found = [
        Case(example, n, strategy)
        for table in ((SIZES, LARGE) if large else (SIZES,))
        for example in examples
        for strategy, usual in table[example].items()
        for n in sizes or usual
        if strategy in strategies
    ]
    return sorted(dict.fromkeys(found), key=lambda case: (case.example, case.n))


def load(path: Path) -> list[Row]:
    """Rows of an earlier run."""
    if not path.exists():
        return []
    return [
        Row(**{**row, "case": Case(**row["case"])}) for row in json.loads(path.read_text(encoding="utf-8"))
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 if every solve succeeded."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--examples", nargs="+", default=list(SIZES), choices=list(SIZES))
    parser.add_argument("--sizes", type=int, nargs="+", help="these n instead of the usual ones")
    parser.add_argument("--strategies", nargs="+", default=list(STRATEGIES), choices=list(STRATEGIES))
    parser.add_argument("--large", action="store_true", help="also meshes of 100,000 and more elements")
    parser.add_argument("--limit", type=float, default=1200.0, help="seconds for one solve")
    parser.add_argument("--out", type=Path, default=Path("scaling"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / "scaling.json"
    rows = load(kept)
    done = {row.case for row in rows}
    for case in cases(options.large, options.strategies, options.examples, options.sizes):
        if case in done:
            continue
        row = isolated(case, options.limit)
        print(f"{case.example}, n = {case.n}, {case.strategy}: {row.status}", file=sys.stderr, flush=True)
        rows.append(row)
        kept.write_text(json.dumps([asdict(row) for row in rows], indent=1), encoding="utf-8")
        (options.out / "scaling.md").write_text(markdown(rows) + "\n", encoding="utf-8")
        figure(rows, options.out / "scaling.png")
    print(markdown(rows))
    return 0 if all(row.status == "converged" for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
