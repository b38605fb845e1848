"""Cost of the strategies against the size of the mesh, counted in contact solves.

    python scripts/benchmark_scaling.py --sizes 8 16 32 64 --out scaling

The unit of cost is one cold contact solve on the same mesh in the same run (median of five).
Example 6.1 is refined with delta = 0.22/n, so that a node may move by the same part of its
neighbourhood. For each strategy the table gives the time to 90 % and 99 % of the best known gain
and to its own end. The best known gain is the lower of what this run reaches and of the figures
below. Writes ``scaling.md`` and ``scaling.png``; every solve is one row, also one that fails.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np

from formulations import joint, mpcc, nested
from rmesh_nlp.equilibrium import ContactModel
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solution import Solution

mpl.use("Agg")
import matplotlib.pyplot as plt

BEST_KNOWN = {8: -1.475162, 16: -1.795842, 32: -1.899262, 64: -1.932563, 128: -1.942139}
"""Least energies seen on these grids by prototypes of ``joint`` and by random starts."""

FEASIBLE = 1e-6
"""Constraint violation below which an iterate of an all-at-once strategy counts."""

STRATEGIES: dict[str, Callable[[ContactProblem], Solution]] = {
    "nested, newton-pair": lambda problem: nested.solve(problem, outer="newton-pair"),
    "nested, newton": lambda problem: nested.solve(problem, outer="newton"),
    "nested, ipopt": nested.solve,
    "joint": joint.solve,
    "mpcc": mpcc.solve,
}


@dataclass(frozen=True)
class Row:
    """One solve on one grid; times in contact solves, None where a share was not reached."""

    n: int
    strategy: str
    status: str
    energy: float
    iterations: int
    unit: float
    total: float
    to_90: float | None
    to_99: float | None
    gain: float


def unit_of_cost(problem: ContactProblem) -> float:
    """Seconds of one cold contact solve, the median of five."""
    model = ContactModel(problem)
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        model.solve(problem.mesh.p)
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds)


def rows_of(n: int, names: list[str]) -> list[Row]:
    """Solve one grid by all strategies."""
    problem = EXAMPLES["6.1"](n)
    unit = unit_of_cost(problem)
    solutions = {}
    for name in names:
        solutions[name] = STRATEGIES[name](problem)
        print(f"n = {n}, {name}: {solutions[name].status.value}", file=sys.stderr)
    initial = next(iter(solutions.values())).energy_initial
    best = min([BEST_KNOWN.get(n, np.inf), *(s.energy for s in solutions.values() if s.success)])
    return [_row(n, name, solution, unit, initial - best) for name, solution in solutions.items()]


def _row(n: int, name: str, solution: Solution, unit: float, best_gain: float) -> Row:
    def reached(share: float) -> float | None:
        for step in solution.history:
            feasible = not step.primal_residual > FEASIBLE
            if feasible and solution.energy_initial - step.energy >= share * best_gain:
                return step.seconds / unit
        return None

    return Row(
        n=n,
        strategy=name,
        status=solution.status.value,
        energy=solution.energy,
        iterations=solution.iterations,
        unit=unit,
        total=solution.wall_time_s / unit,
        to_90=reached(0.9),
        to_99=reached(0.99),
        gain=(solution.energy_initial - solution.energy) / best_gain,
    )


def markdown(rows: list[Row]) -> str:
    """The rows as a Markdown table."""

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.1f}" if value < 100 else f"{value:.0f}"

    lines = [
        "| n | strategy | status | energy | best gain | iterations | to 90 % | to 99 % | all | unit [s] |",
        "|--:|:--|:--|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.n} | {r.strategy} | {r.status} | {r.energy:.6f} | {100 * r.gain:.2f} % | {r.iterations} "
        f"| {number(r.to_90)} | {number(r.to_99)} | {number(r.total)} | {r.unit:.4f} |"
        for r in rows
    ]
    return "\n".join(lines)


def figure(rows: list[Row], path: Path) -> None:
    """Cost to the end and to 99 % of the gain against the number of squares per side."""
    colours = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7")
    fig, axes = plt.subplots(1, 2, figsize=(7, 3), sharey=True, layout="constrained")
    for axis, title, cost in (
        (axes[0], "to 99 % of the best known gain", lambda r: r.to_99),
        (axes[1], "to the end", lambda r: r.total),
    ):
        for name, colour, marker in zip(STRATEGIES, colours, "vos^D", strict=True):
            points = [(r.n, cost(r)) for r in rows if r.strategy == name and cost(r) is not None]
            if points:
                axis.loglog(*zip(*points, strict=True), marker=marker, color=colour, label=name)
        sizes = sorted({r.n for r in rows})
        axis.set_xticks(sizes, [str(n) for n in sizes])
        axis.minorticks_off()
        axis.set(xlabel="squares per side n", title=title)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("cost [contact solves]")
    axes[1].legend(fontsize=8)
    fig.savefig(path, dpi=200)
    plt.close(fig)


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if every solve succeeded."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 32])
    parser.add_argument("--strategies", nargs="+", default=list(STRATEGIES), choices=list(STRATEGIES))
    parser.add_argument("--out", type=Path, default=Path("scaling"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for n in options.sizes:
        rows += rows_of(n, options.strategies)
        # after every grid, so that an interruption keeps what is done
        (options.out / "scaling.md").write_text(markdown(rows) + "\n", encoding="utf-8")
    figure(rows, options.out / "scaling.png")
    print(markdown(rows))
    return 0 if all(row.status == "converged" for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
