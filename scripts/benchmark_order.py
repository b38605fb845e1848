"""What relocation gains at order 2: error against unknowns and processor time, beside order 1 and peers.

    python scripts/benchmark_order.py                    every problem (an hour)
    python scripts/benchmark_order.py --cases 6.1 wedge --levels 2

Meshes of both orders have as many unknown nodes (vertices, and at order 2 middles of edges). Uniform and
h-adaptive meshes are scikit-fem's own where ``best_mesh/adaptive.py`` has the problem; else the package
refines, and the loop has no time. docs/order_and_relocation.md says how errors are measured.
Rows are kept in DIR/rows.jsonl: run again, it measures only what is missing. Writes DIR/table.md and
DIR/order.png.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from best_mesh import adaptive as plain
from best_mesh import methods
from best_mesh.cases import CASES, MORE, Case
from best_mesh.methods import ADAPTIVE, RELOCATED, REMESHED, UNIFORM, Task, limit, measured, unknowns
from best_mesh.tables import at, cases, draw, finished, of, times, written
from rows import Row, Store, command_line

SIZES = {
    "L-shape r^(2/3)": (4, 8, 16, 32),
    "6.1": (4, 8, 16, 32, 64),
    "wedge": (4, 8, 16, 32),
    "Signorini": (5, 10, 20, 40),
    "6.2": (0, 1, 2, 3),
    "6.3": (6, 12, 24, 48),
    "Hertz": (4, 9, 18),
    "plate": (0, 1, 2),
    "two materials": (9, 18, 36),
    "punch": (11, 22, 44),
    "membrane": (11, 22, 44),
    "two supports": (8, 16, 32),
    "bracket": (0, 1, 2),
}
"""Sizes of the meshes. That of order 1 with as many unknowns is one finer than that of order 2."""

SHOWN = {"L-shape r^(2/3)": r"L-shape, $r^{2/3}$", "6.1": "Example 6.1", "wedge": "wedge with friction"}
"""Cases of the figure, and what they are called there."""

METHODS = (UNIFORM, ADAPTIVE, RELOCATED, REMESHED)

MOST = {UNIFORM: 80_000, ADAPTIVE: 30_000}
"""Nodes up to which meshes of scikit-fem go."""

MANY = 1000
"""Nodes from which on times are compared."""


def tasks(case: Case, levels: int | None) -> Iterator[Task]:
    """Meshes of both orders, the last ones of all sizes but one."""
    sizes = SIZES[case.name]
    for order in (2, 1):
        own = sizes[2 - order : len(sizes) + 1 - order][:levels]
        if case.equations is not None:
            for method, loop in ((UNIFORM, plain.uniform), (ADAPTIVE, plain.adaptive)):
                run = partial(methods.by_scikit_fem, case, own[0], order, loop, MOST[method])
                yield order, method, 0, run
        else:
            most = unknowns(case.problem(own[-1], order))
            yield order, ADAPTIVE, 0, partial(methods.refined, case, own[0], order, most)
            for size in (*own, *sizes[len(own) + 2 - order :][:1]):
                yield order, UNIFORM, size, partial(methods.uniform, case, size, order)
        for size in own:
            for method in (RELOCATED, REMESHED):
                yield order, method, size, partial(methods.relocated, case, size, order, method == REMESHED)


def at_equal_unknowns(rows: Sequence[Row], case: str, order: int) -> pd.DataFrame:
    """By nodes of the relocated meshes of order 2: errors of as many by all methods at an order.

    New meshes have a few more or less: as if errors fell by the power of the order.
    """
    nodes = of(rows, case, RELOCATED, 2).nodes
    result = pd.DataFrame(index=nodes, columns=METHODS, dtype=float)
    for method in METHODS:
        own = of(rows, case, method, order)
        if method in (UNIFORM, ADAPTIVE):
            result[method] = [at(own.nodes, own.error, count) for count in nodes]
        else:
            same = own.reindex(range(len(nodes)))
            result[method] = (same.error * (same.nodes / nodes) ** order).to_numpy()
    return result


def factors(rows: Sequence[Row]) -> pd.DataFrame:
    """Error of uniform meshes over that of the others with as many unknowns, and rates, at order 2."""
    parts = []
    for case in cases(rows):
        errors = at_equal_unknowns(rows, case, 2)
        part = pd.DataFrame({"problem": case, "nodes": errors.index, "error, uniform": [*errors[UNIFORM]]})
        part["known to"] = limit(rows, case)[1]
        finer = np.log(part.nodes / part.nodes.shift()).to_numpy()
        for method in METHODS[1:]:
            part[method] = (errors[UNIFORM] / errors[method]).to_numpy()
        for method in (UNIFORM, RELOCATED, REMESHED):
            part[f"rate, {method}"] = -np.log(errors[method] / errors[method].shift()).to_numpy() / finer
        parts.append(part)
    return pd.concat(parts)


def orders(rows: Sequence[Row]) -> pd.DataFrame:
    """Errors of order 1 over those of order 2, with as many unknowns."""
    parts = []
    for case in cases(rows):
        first, second = (at_equal_unknowns(rows, case, order) for order in (1, 2))
        part = first / second
        part["order 1 uniform over order 2 remeshed, relocated"] = first[UNIFORM] / second[REMESHED]
        part.insert(0, "problem", case)
        part.insert(1, "nodes", part.index)
        parts.append(part)
    return pd.concat(parts)


def picture(rows: Sequence[Row]) -> Figure:
    """Error against unknowns and against time: orders 1 (open, dashed) and 2 of all methods."""
    sheet = Figure(figsize=(8, 6.4), layout="constrained")
    axes = sheet.subplots(2, len(SHOWN), sharey="col")
    for column, (case, title) in enumerate(SHOWN.items()):
        for axis, x in zip(axes[:, column], ("nodes", "seconds"), strict=True):
            for method, order in product(METHODS, (1, 2)):
                look = {"markerfacecolor": "white", "linestyle": "--"} if order == 1 else {}
                own = of(rows, case, method, order)
                draw(axis, own, x, method, label=f"order {order}, {method}", **look)
        axes[0, column].set(title=title)
    for axis in axes[:, 0]:
        axis.set_ylabel("error (squared energy norm)")
    return finished(sheet, "unknown nodes")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the tables and the figure."""
    parser = command_line(__doc__, out="results/order")
    parser.add_argument("--cases", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--levels", type=int, help="meshes of each problem, the coarsest ones; default: all")
    options = parser.parse_args(arguments)
    store = Store(options.out / "rows.jsonl")
    methods.warm_up()
    for name in options.cases:
        measured(store, {**CASES, **MORE}[name], partial(tasks, levels=options.levels))
    compared = times(store.rows, 2, (RELOCATED, REMESHED), (UNIFORM, ADAPTIVE), MANY)
    tables = factors(store.rows), orders(store.rows), compared
    written(options.out, tables, picture(store.rows), "order.png")
    return 0 if all(np.isfinite(row.get("error", np.nan)) for row in store.rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
