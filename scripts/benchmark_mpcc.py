"""The MPCC solver beside a plain Scholtes loop, MPECSS and pympcc: a collection and generated families.

    python scripts/benchmark_mpcc.py mpcc_problems.py --families all --out results/mpcc

A collection is a Python file with ``names()`` and ``get(name)``; ``get`` returns a dict with ``x f g G H lbx
ubx lbg ubg x0 target`` (CasADi expressions, bounds, a start, the best known value). AMPL .nl files and
NOSBENCH's .json files, and folders of them, are read too. Every solve is a process of its own; with
--together all are solved in this one, one after the other, which is fairer to the time of small problems:
a forked process copies each page of memory that it touches, most of them Python's. What a solver ends
with is measured by the problem's expressions, not taken from the solver: solved is a point whose constraint
violation and products G H are at most 1e-6, lowest one whose objective is also within 1e-4, relative, of the
best known value or, where none is known, of the least that any solver here found. Time is processor time of
build and solve. MPECSS and pympcc are compared if they are installed (see benchmark_peers.py). Writes
DIR/rows.jsonl and DIR/table.md; of the large families obstacle-control, membrane and membrane-pressure (not
in "all") also DIR/size.png, time against pairs. ``--resume`` keeps the rows in DIR.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from isolated import Failed, isolated
from mpcc_library.families import FAMILIES
from mpcc_library.large import LARGE
from mpcc_library.solvers import NEEDS, SOLVERS
from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import MPCC, Problem, read
from rmesh_nlp.mpcc.reading import READERS

SOLVED, LOWEST = 1e-6, 1e-4
COLOURS = ("#0072B2", "#D55E00", "#009E73")  # told apart by the colour-blind: Okabe and Ito (2008)


@dataclass(frozen=True)
class Row:
    """One solver on one problem; NaN where it did not come to an end."""

    group: str
    problem: str
    solver: str
    status: str
    f: float = float("nan")
    violation: float = float("inf")
    target: float = float("nan")
    iterations: int | None = None
    seconds: float = float("nan")


def read_collection(path: Path) -> Iterator[Problem]:
    """The problems of a Python file, in its order; ValueError if there is none."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{path} is not a Python file")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    for name in module.names():
        found = module.get(name)
        program = {key: found[key] for key in ("x", "f", "g", "G", "H", "lbx", "ubx", "lbg", "ubg")}
        x0, target = np.asarray(found["x0"], dtype=float), float(found.get("target", math.nan))
        yield Problem(name, MPCC(**program), x0, target=target)


def problems(
    paths: Sequence[Path], families: Sequence[str], sizes: int, seeds: int
) -> Iterator[tuple[str, Problem]]:
    """Problems of files and of generated families ("all", or names), each with its group."""
    for path in paths:
        if path.suffix == ".py":
            yield from ((path.stem, problem) for problem in read_collection(path))
            continue
        files = (
            [p for p in sorted(path.rglob("*")) if p.suffix.lower() in READERS] if path.is_dir() else [path]
        )
        yield from ((one.parent.name, read(one)) for one in files)
    for name in list(FAMILIES) if list(families) == ["all"] else families:
        if name not in (known_families := {**FAMILIES, **LARGE}):
            raise ValueError(f"unknown family {name!r}; there are {', '.join(['all', *known_families])}")
        make, known = known_families[name]
        yield from ((name, make(size, seed)) for size in known[:sizes] for seed in range(seeds))


def measured(problem: Problem, x: Array) -> tuple[float, float]:
    """Objective of a point, and the largest of its constraint violation and its products."""
    mpcc = problem.mpcc
    found = ca.Function("all", [mpcc.x, mpcc.p], [mpcc.f, mpcc.g, mpcc.G, mpcc.H])
    f, g, G, H = (np.asarray(v.full()).ravel() for v in found(x, mpcc.parameters(problem.p0)))
    excess = [mpcc.lbx - x, x - mpcc.ubx, mpcc.lbg - g, g - mpcc.ubg, -G, -H, np.abs(G * H)]
    return problem.sign * float(f[0]), float(np.max(np.concatenate(excess), initial=0.0))


def solved(group: str, problem: Problem, solver: str, limit: float, together: bool = False) -> Row:
    """Solve one problem in a process of its own, or ``together`` with the others in this one."""

    def work() -> Row:
        began = time.process_time()
        end = SOLVERS[solver](problem)
        seconds = time.process_time() - began
        f, violation = measured(problem, end.x)
        return Row(*key, end.status, f, violation, problem.target, end.iterations, seconds)

    key = (group, problem.name, solver)
    row = work() if together else isolated(work, limit)
    return Row(*key, row.why, seconds=limit) if isinstance(row, Failed) else row


def table(rows: Sequence[Row]) -> str:
    """A line for each group and solver, in Markdown."""
    least = {row.problem: row.target for row in rows}
    for row in rows:
        if not np.isfinite(row.target) and row.violation <= SOLVED:
            least[row.problem] = float(np.nanmin([least[row.problem], row.f]))
    lines = [
        "| problems | solver | solved | lowest | iterations | time [s] | over ours |",
        "|:--|:--" + "|--:" * 5 + "|",
    ]
    groups = list(dict.fromkeys(row.group for row in rows))
    for group in groups + (["all"] if len(groups) > 1 else []):
        ours = 0.0
        for solver in dict.fromkeys(row.solver for row in rows):
            own = [row for row in rows if row.solver == solver and group in (row.group, "all")]
            good = [row for row in own if row.violation <= SOLVED]
            low = [r for r in good if r.f - least[r.problem] <= LOWEST * max(1.0, abs(least[r.problem]))]
            seconds, counts = sum(row.seconds for row in own), [row.iterations for row in own]
            ours = ours or seconds
            iterations = "-" if None in counts else str(sum(count or 0 for count in counts))
            cells = (
                f"{group}, {len(own)}",
                solver,
                len(good),
                len(low),
                iterations,
                f"{seconds:.2f}",
                f"{seconds / ours:.2f}",
            )
            lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def by_size(rows: Sequence[Row]) -> dict[tuple[str, str], dict[int, float]]:
    """Of each large family and solver the median time for a number of pairs, of solved problems."""
    found: dict[tuple[str, str], dict[int, list[float]]] = {}
    for row in rows:
        size = row.problem.split("-")[-2:-1]
        if row.group in LARGE and size and row.violation <= SOLVED:
            found.setdefault((row.group, row.solver), {}).setdefault(int(size[0]), []).append(row.seconds)
    return {
        key: {size: float(np.median(own[size])) for size in sorted(own)}
        for key, own in sorted(found.items(), key=lambda item: list(LARGE).index(item[0][0]))
    }


def size_table(rows: Sequence[Row]) -> str:
    """Time against pairs, a line for each size and a column for each solver, in Markdown."""
    times = by_size(rows)
    solvers = list(dict.fromkeys(row.solver for row in rows))
    lines = [
        f"| problem | pairs | {' | '.join(f'{s} [s]' for s in solvers)} |",
        "|---|" + "--:|" * (len(solvers) + 1),
    ]
    for group in dict.fromkeys(group for group, _ in times):
        own = [times.get((group, solver), {}) for solver in solvers]
        for size in sorted(set().union(*own)):
            cells = [f"{one[size]:.1f}" if size in one else "-" for one in own]
            lines.append(f"| {group} | {size:,} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def figure(rows: Sequence[Row], path: Path) -> None:
    """Processor time against pairs: a colour for each family, solid for ours and dashed for others."""
    times = by_size(rows)
    if not times:
        return
    drawing, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for (group, solver), own in times.items():
        line, marker = ("-", "o") if solver == next(iter(SOLVERS)) else ("--", "s")
        colour = COLOURS[list(LARGE).index(group) % len(COLOURS)]
        fill = colour if line == "-" else "white"
        axes.loglog(
            list(own), list(own.values()), color=colour, linestyle=line, marker=marker, markerfacecolor=fill,
            label=f"{group}, {solver}",
        )  # fmt: skip
    axes.set(xlabel="complementarity pairs", ylabel="processor time [s]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    drawing.savefig(path, dpi=150)
    plt.close(drawing)


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, print, write; 0 if ours solved every problem."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "paths", nargs="*", type=Path, metavar="FILE", help="collections, .nl, .json, folders"
    )
    parser.add_argument("--families", help="generated problems: all, or names")
    parser.add_argument("--sizes", type=int, default=2, help="sizes of each family")
    parser.add_argument("--seeds", type=int, default=4, help="problems of each size")
    parser.add_argument("--solvers", nargs="+", choices=list(SOLVERS), default=list(SOLVERS))
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for one solve")
    parser.add_argument("--together", action="store_true", help="in this process, without a limit")
    parser.add_argument("--out", type=Path, default=Path("results/mpcc"))
    parser.add_argument("--resume", action="store_true", help="solve only what --out has no row of")
    given = parser.parse_args(arguments)
    names = given.families.split(",") if given.families else []
    try:
        known = list(problems(given.paths, names, given.sizes, given.seeds))
    except (AttributeError, ValueError, OSError) as error:
        parser.error(str(error))
    if not known:
        parser.error("no problems: give files or --families")
    there = [name for name in given.solvers if all(map(importlib.util.find_spec, NEEDS.get(name, ())))]
    warm = ca.SX.sym("warm")  # loading Ipopt's library is nobody's cost
    ca.nlpsol("warm", "ipopt", {"x": warm, "f": warm**2}, {"ipopt": {"print_level": 0, "sb": "yes"}})(x0=1)
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "rows.jsonl"
    kept = path.read_text(encoding="utf-8").splitlines() if given.resume and path.is_file() else []
    rows = [Row(**json.loads(line)) for line in kept]
    with path.open("a" if given.resume else "w", encoding="utf-8") as file:
        done = {(row.problem, row.solver) for row in rows}
        for (group, problem), solver in ((one, solver) for one in known for solver in there):
            if (problem.name, solver) in done:
                continue
            rows.append(solved(group, problem, solver, given.limit, given.together))
            file.write(json.dumps(asdict(rows[-1])) + "\n")
            file.flush()
            last = rows[-1]
            print(f"{last.problem:26} {solver:20} {last.status[:24]:24} {last.f:<14.8g} {last.seconds:.2f} s")
    tables = table(rows) + ("\n" + size_table(rows) if by_size(rows) else "")
    (given.out / "table.md").write_text(tables, encoding="utf-8")
    figure(rows, given.out / "size.png")
    print("\n" + tables)
    mine = [row for row in rows if row.solver == next(iter(SOLVERS))]
    return 0 if all(row.violation <= SOLVED for row in mine) else 1


if __name__ == "__main__":
    sys.exit(main())
