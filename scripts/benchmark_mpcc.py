r"""The MPCC solver beside a plain Scholtes loop, MPECSS and pympcc: a collection and generated families.

    python scripts/benchmark_mpcc.py mpcc_problems.py --families all --out results/mpcc

A collection is a Python file with ``names()`` and ``get(name)``; ``get`` returns a dict with ``x f g G H lbx
ubx lbg ubg x0 target`` (CasADi expressions, bounds, a start, the best known value). AMPL .nl files and
NOSBENCH's .json files, and folders of them, are read too. Every solve is a process of its own; with
--together all are solved in this one, which is fairer to the time of small problems: a forked process copies
the memory that it touches. docs/results.md says what is counted. Time is processor time of build and solve.
Writes DIR/rows.jsonl, DIR/table.md and DIR/profile.png, the share of problems that a solver ends within a
factor of the least time of any; of the large families obstacle-control, membrane and membrane-pressure
(not in "all") also DIR/size.png, time against pairs. Run again, it solves only what DIR has no row of.

MPECSS and pympcc are compared if they are installed: ``pip install mpecss pympcc``. cyipopt, which pympcc
needs, is built against the Ipopt in CasADi's wheel, and so is the very Ipopt that ours uses::

    C=$(python -c "import casadi; print(casadi.__path__[0])")
    CFLAGS="-I$C/include/coin-or" LDFLAGS="-L$C -Wl,-rpath,$C" PKG_CONFIG_PATH=$C/pkgconfig \
        pip install cyipopt
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from isolated import Failed, isolated
from mpcc_library.applications import APPLICATIONS
from mpcc_library.families import FAMILIES
from mpcc_library.large import LARGE
from mpcc_library.solvers import NEEDS, SOLVERS
from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc import MPCC, Problem, read
from rmesh_nlp.mpcc.reading import READERS
from rows import Row, Store, command_line, markdown, timed

SOLVED, LOWEST = 1e-6, 1e-4
SHOWN = ("solved", "lowest")
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")  # told apart by the colour-blind: Okabe and Ito (2008)


def read_collection(path: Path) -> Iterator[Problem]:
    """The problems of a Python file, in its order; ValueError if there is none."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{path} is not a Python file")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    for name in module.names():
        values = module.get(name)
        program = {key: values[key] for key in ("x", "f", "g", "G", "H", "lbx", "ubx", "lbg", "ubg")}
        x0, target = np.asarray(values["x0"], dtype=float), float(values.get("target", math.nan))
        yield Problem(name, MPCC(**program), x0, target=target)


def problems(
    paths: Sequence[Path], families: Sequence[str], sizes: int, seeds: int
) -> Iterator[tuple[str, Problem]]:
    """Problems of files and of generated families ("all", "applications", or names), each with its group."""
    for path in paths:
        if path.suffix == ".py":
            yield from ((path.stem, problem) for problem in read_collection(path))
            continue
        files = (
            [p for p in sorted(path.rglob("*")) if p.suffix.lower() in READERS] if path.is_dir() else [path]
        )
        yield from ((file.parent.name, read(file)) for file in files)
    groups = {"all": list(FAMILIES), "applications": list(APPLICATIONS)}
    known_families = {**FAMILIES, **APPLICATIONS, **LARGE}
    for name in [name for family in families for name in groups.get(family, [family])]:
        if name not in known_families:
            raise ValueError(f"unknown family {name!r}; there are {', '.join([*groups, *known_families])}")
        make, sizes_of = known_families[name]
        yield from ((name, make(size, seed)) for size in sizes_of[:sizes] for seed in range(seeds))


def measured(problem: Problem, x: Array) -> tuple[float, float]:
    """Objective of a point, and the largest of its constraint violation and its products."""
    mpcc = problem.mpcc
    values = ca.Function("all", [mpcc.x, mpcc.p], [mpcc.f, mpcc.g, mpcc.G, mpcc.H])
    f, g, G, H = (np.asarray(v.full()).ravel() for v in values(x, mpcc.parameters(problem.p0)))
    excess = [mpcc.lbx - x, x - mpcc.ubx, mpcc.lbg - g, g - mpcc.ubg, -G, -H, np.abs(G * H)]
    return problem.sign * float(f[0]), float(np.max(np.concatenate(excess), initial=0.0))


def solved(problem: Problem, solver: str, limit: float, together: bool = False) -> Iterator[Row]:
    """Solve one problem in a process of its own, or ``together`` with the others in this one."""

    def work() -> Row:
        end, seconds = timed(SOLVERS[solver], problem)
        f, violation = measured(problem, end.x)
        ending = {"status": end.status, "f": f, "violation": violation}
        return ending | {"iterations": end.iterations, "seconds": seconds}

    row = work() if together else isolated(work, limit)
    row = {"status": row.why, "seconds": limit} if isinstance(row, Failed) else row
    yield {"pairs": problem.mpcc.n_pairs, "target": problem.target, **row}


def judged(rows: Sequence[Row]) -> pd.DataFrame:
    """Rows with ``solved`` and ``lowest``, see above; what did not come to an end is neither."""
    columns = ["group", "problem", "solver", "pairs", "target", "f", "violation", "iterations", "seconds"]
    frame = pd.DataFrame(rows, columns=columns)
    frame["solved"] = frame.violation <= SOLVED
    least = frame.f.where(frame.solved).groupby(frame.problem).transform("min")
    best = frame.target.astype(float).fillna(least)
    frame["lowest"] = frame.solved & (frame.f - best <= LOWEST * np.maximum(1.0, best.abs()))
    return frame


def table(rows: Sequence[Row]) -> str:
    """A line for each group and solver, in Markdown."""
    frame, parts = judged(rows), []
    if frame.group.nunique() > 1:
        frame = pd.concat([frame, frame.assign(group="all")])
    for group, own in frame.groupby("group", sort=False):
        sums = own.groupby("solver", sort=False)[[*SHOWN, "seconds"]].sum()
        counted = own.groupby("solver", sort=False).iterations.agg(lambda column: column.sum(skipna=False))
        problems_of = own.solver.value_counts(sort=False).astype(str)
        part = pd.DataFrame({"problems": [*f"{group}, " + problems_of], "solver": sums.index})
        part[[*SHOWN]] = sums[[*SHOWN]].to_numpy()
        part["iterations"] = [*counted.map("{:.0f}".format, "ignore")]
        part["time [s]"] = [*sums.seconds.map("{:.2f}".format)]
        part["over ours"] = [*(sums.seconds / sums.seconds.iloc[0]).map("{:.2f}".format)]
        parts.append(part)
    return markdown(pd.concat(parts))


def by_size(rows: Sequence[Row]) -> pd.DataFrame:
    """Median time of the large families by family and pairs, a column for each solver; of solved problems."""
    frame = judged(rows)
    frame = frame[frame.solved & frame.group.isin(LARGE)]
    return frame.pivot_table(
        values="seconds", index=["group", "pairs"], columns="solver", aggfunc="median", sort=False
    ).sort_index()


def size_table(rows: Sequence[Row]) -> str:
    """Time against pairs, a line for each size and a column for each solver, in Markdown."""
    return markdown(by_size(rows).rename(columns="{} [s]".format).reset_index())


def figure(rows: Sequence[Row], path: Path) -> None:
    """Processor time against pairs: a colour for each family, solid for ours and dashed for others."""
    times = by_size(rows)
    if times.empty:
        return
    drawing, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for solver in times:
        is_ours = solver == next(iter(SOLVERS))
        for colour, (group, own) in zip(COLOURS, times[solver].groupby("group"), strict=False):
            pairs, fill = own.index.get_level_values("pairs"), colour if is_ours else "white"
            look = {"color": colour, "linestyle": "-" if is_ours else "--", "marker": "o" if is_ours else "s"}
            axes.loglog(pairs, own, markerfacecolor=fill, label=f"{group}, {solver}", **look)
    axes.set(xlabel="complementarity pairs", ylabel="processor time [s]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    drawing.savefig(path, dpi=150)
    plt.close(drawing)


def profile(rows: Sequence[Row]) -> pd.DataFrame:
    """Time over the least of all solvers that end at the lowest point, by problem; infinite for other ends.

    E. D. Dolan and J. J. More, Benchmarking optimization software with performance profiles, Math. Program.
    91 (2002) 201-213.
    """
    frame = judged(rows)
    times = frame.assign(seconds=frame.seconds.where(frame.lowest, np.inf)).pivot_table(
        values="seconds", index="problem", columns="solver", sort=False
    )
    least = times.min(axis=1)
    return times[np.isfinite(least)].div(least[np.isfinite(least)], axis=0)


def profile_figure(rows: Sequence[Row], path: Path) -> None:
    """Share of the problems within a factor of the least time, a line for each of several solvers."""
    ratios = profile(rows)
    if ratios.shape[1] < 2:
        return
    drawing, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    most = 2 * float(ratios.where(np.isfinite(ratios)).max(axis=None))
    for solver, colour in zip(ratios, COLOURS, strict=False):
        ends = np.sort(ratios[solver][np.isfinite(ratios[solver])])
        shares = np.arange(ends.size + 1) / len(ratios)
        steps, shares = np.concatenate([[1.0], ends, [most]]), np.append(shares, shares[-1])
        axes.step(steps, shares, where="post", color=colour, label=solver)
    axes.set(xscale="log", xlim=(1.0, most), ylim=(0.0, 1.02))
    axes.set(xlabel="processor time over the least of all solvers", ylabel="share of problems")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("{x:g}")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    drawing.savefig(path, dpi=150)
    plt.close(drawing)


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve, print, write; 0 if ours solved every problem."""
    parser = command_line(__doc__, out="results/mpcc")
    parser.add_argument(
        "paths", nargs="*", type=Path, metavar="FILE", help="collections, .nl, .json, folders"
    )
    parser.add_argument("--families", help="generated problems: all, applications, or names")
    parser.add_argument("--sizes", type=int, default=2, help="sizes of each family")
    parser.add_argument("--seeds", type=int, default=4, help="problems of each size")
    parser.add_argument("--solvers", nargs="+", choices=list(SOLVERS), default=list(SOLVERS))
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for one solve")
    parser.add_argument("--together", action="store_true", help="in this process, without a limit")
    options = parser.parse_args(arguments)
    families = options.families.split(",") if options.families else []
    try:
        chosen = list(problems(options.paths, families, options.sizes, options.seeds))
    except (AttributeError, ValueError, OSError) as error:
        parser.error(str(error))
    if not chosen:
        parser.error("no problems: give files or --families")
    installed = [name for name in options.solvers if all(map(importlib.util.find_spec, NEEDS.get(name, ())))]
    warm = ca.SX.sym("warm")  # loading Ipopt's library is nobody's cost
    ca.nlpsol("warm", "ipopt", {"x": warm, "f": warm**2}, {"ipopt": {"print_level": 0, "sb": "yes"}})(x0=1)
    store = Store(options.out / "rows.jsonl")
    for (group, problem), solver in product(chosen, installed):
        key = {"group": group, "problem": problem.name, "solver": solver}
        store.measure(key, partial(solved, problem, solver, options.limit, options.together))
    text = table(store.rows) + ("" if by_size(store.rows).empty else "\n" + size_table(store.rows))
    (options.out / "table.md").write_text(text, encoding="utf-8")
    figure(store.rows, options.out / "size.png")
    profile_figure(store.rows, options.out / "profile.png")
    print("\n" + text)
    frame = judged(store.rows)
    return 0 if frame.solved[frame.solver == next(iter(SOLVERS))].all() else 1


if __name__ == "__main__":
    sys.exit(main())
