"""Which mesh of N nodes is best? Error against nodes and processor time, beside peers and what is attainable.

    python scripts/benchmark_mesh.py                     every problem (15 minutes)
    python scripts/benchmark_mesh.py --cases 6.1 L-shape --levels 2

Factors are errors of the given mesh over those of the method at equal nodes; docs/results.md says what the
methods are and how errors are measured. Rows are kept in DIR/rows.jsonl: run again, it measures only what is
missing. Writes DIR/table.md and DIR/best_mesh.png.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from best_mesh import adaptive as plain
from best_mesh import methods
from best_mesh.cases import CASES, Case
from best_mesh.methods import (
    ADAPTIVE,
    ATTAINABLE,
    LOOP,
    METRIC,
    RELOCATED,
    REMESHED,
    UNIFORM,
    Task,
    by_scikit_fem,
)
from best_mesh.tables import at, cases, finished, of, side_by_side, times, written
from rows import Row, Store, command_line

MANY = 300
"""Nodes from which on times are compared."""


def tasks(case: Case, levels: int | None) -> Iterator[Task]:
    """Meshes of a number of sizes, the coarsest ones, beside what they are compared with."""
    sizes = case.sizes[:levels]
    most, coarse = methods.unknowns(case.problem(max(sizes))), case.sizes[0]
    if case.equations is None:
        yield 1, ADAPTIVE, most, partial(methods.refined, case, coarse, 1, most)
        yield 1, LOOP, most, partial(methods.metric_loop, case, most)
    else:  # cheap, and followed to the errors of relocated meshes
        many = max(8 * most, 10_000)
        yield 1, ADAPTIVE, most, partial(by_scikit_fem, case, coarse, 1, plain.adaptive, many)
        yield 1, LOOP, most, partial(methods.metric_loop, case, max(2 * most, 6_000))
    for size in sizes:
        if case.equations is not None:
            meshes = by_scikit_fem(case, size, 2, plain.uniform, 80_000)
            yield 2, UNIFORM, size, partial(islice, meshes, 1)
        yield 1, UNIFORM, size, partial(methods.uniform, case, size)
        yield 1, ATTAINABLE, size, partial(methods.attainable, case, size)
        yield 1, METRIC, size, partial(methods.metric, case, size)
        for method in (RELOCATED, REMESHED):
            yield 1, method, size, partial(methods.relocated, case, size, 1, method == REMESHED)


def factors(rows: Sequence[Row]) -> pd.DataFrame:
    """Error of each given mesh over those of all methods, at equal nodes."""
    lines = []
    for name in cases(rows):
        own = {method: of(rows, name, method) for method in (METRIC, RELOCATED, REMESHED, ATTAINABLE)}
        for given in of(rows, name, UNIFORM).itertuples():
            line = {"problem": name, "nodes": given.nodes}
            for method, curve in (("P2", of(rows, name, UNIFORM, 2)), (ADAPTIVE, of(rows, name, ADAPTIVE))):
                line[method] = given.error / at(curve.nodes, curve.error, given.nodes)
            for method, frame in own.items():
                mesh = frame[frame["size"] == given.size]
                line[method] = (given.error / mesh.error * given.nodes / mesh.nodes).min()
                line[f"{method} [s]"] = mesh.seconds.min()
            lines.append({**line, "share": line[REMESHED] / line[ATTAINABLE]})
    columns = ["problem", "nodes", "P2", ADAPTIVE, METRIC, RELOCATED, REMESHED, ATTAINABLE, "share"]
    return pd.DataFrame(lines)[[*columns, f"{RELOCATED} [s]", f"{REMESHED} [s]"]]


def picture(rows: Sequence[Row], case: str = "6.1") -> Figure:
    """Error against nodes and against time."""
    methods = (UNIFORM, ADAPTIVE, LOOP, RELOCATED, REMESHED)
    second = {"color": "#E69F00", "marker": "x", "label": "second order, uniform"}
    curves = [(method, 1, {"label": method}) for method in methods] + [(UNIFORM, 2, second)]
    sheet, left = side_by_side(rows, case, curves)
    bound = of(rows, case, ATTAINABLE)
    left.loglog(bound.nodes, bound.error, "k--", label="attainable with linear elements")
    left.set(ylabel=f"error of the energy, Example {case}")
    return finished(sheet)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the table and the figure."""
    parser = command_line(__doc__, out="results/mesh")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--levels", type=int, help="meshes of each problem, the coarsest ones; default: all")
    options = parser.parse_args(arguments)
    methods.warm_up()
    store = Store(options.out / "rows.jsonl")
    for name in options.cases:
        methods.measured(store, CASES[name], partial(tasks, levels=options.levels))
    compared = times(store.rows, 1, (LOOP, RELOCATED, REMESHED), (ADAPTIVE,), MANY)
    written(options.out, (factors(store.rows), compared), picture(store.rows), "best_mesh.png")
    return 0 if all(np.isfinite(row.get("error", np.nan)) for row in store.rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
