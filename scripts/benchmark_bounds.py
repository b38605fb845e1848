"""How close bounds of a contact force are: half their width against nodes and processor time, by the mesh.

    python scripts/benchmark_bounds.py my.toml part.toml --levels 3

Each problem file is solved without move limits, of orders 1 and 2: on its mesh and uniform refinements of it
as they are, relocated, and on a new mesh of as many nodes that is relocated; and on meshes that are refined
where the interpolation error is. The bounds are those of the force on the first contact boundary, in per cent
of it. Rows are kept in DIR/rows.jsonl: run again, it measures only what is missing. Writes DIR/table.md and
DIR/force_bounds.png, of the first problem.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import pandas as pd
from matplotlib.figure import Figure

import rmesh_nlp as rm
from best_mesh.cases import next_mesh
from best_mesh.methods import ADAPTIVE, RELOCATED, REMESHED, UNIFORM, Task, measure, unknowns, warm_up
from best_mesh.tables import cases, finished, side_by_side, written
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rows import Row, Store, command_line, timed

METHODS = (UNIFORM, ADAPTIVE, RELOCATED, REMESHED)


def bounded(problem: ContactProblem, formulation: str, remesh: bool = False) -> Row:
    """Half the width of the guaranteed bounds of the first contact force, in per cent of it."""

    def work() -> tuple[rm.Solution, rm.Certificate]:
        solution = rm.solve(problem, formulation, **({"remesh": True} if remesh else {}))
        return solution, rm.certify(solution)

    (solution, certificate), seconds = timed(work)
    force = next(iter(certificate.bounds.values()))
    width = 50 * (force.upper - force.lower) / force.value if force.guaranteed else float("nan")
    nodes = unknowns(replace(solution.problem, mesh=solution.mesh))
    return {"nodes": nodes, "error": width, "seconds": seconds, "status": solution.status.value}


def adapted(problem: ContactProblem, most: int) -> Iterator[Row]:
    """Meshes refined where the error is, each of twice the nodes of the last; seconds are those of all."""
    spent, due = 0.0, 0
    while unknowns(problem) <= most:
        if unknowns(problem) >= due:
            row = bounded(problem, "fixed")
            yield {**row, "seconds": spent + row["seconds"]}
            due = 2 * unknowns(problem)
        problem, seconds = timed(next_mesh, problem)
        spent += seconds


def tasks(given: ContactProblem, levels: int) -> Iterator[Task]:
    """Meshes as they are, relocated and new, and those of local refinement."""
    for order in (1, 2):
        problem = replace(given, order=order)
        for level in range(levels):
            for method, formulation in ((UNIFORM, "fixed"), (RELOCATED, "auto"), (REMESHED, "auto")):
                work = partial(bounded, problem, formulation, method == REMESHED)
                yield order, method, level, lambda work=work: iter([work()])
            most, problem = unknowns(problem), refined(problem)
        yield order, ADAPTIVE, 0, partial(adapted, replace(given, order=order), most)


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """A line for each mesh."""
    columns = ["case", "order", "method", "nodes", "error", "seconds", "status"]
    frame = pd.DataFrame(rows, columns=columns)
    return frame.rename(columns={"error": "half the width [%]", "seconds": "processor time [s]"})


def picture(rows: Sequence[Row]) -> Figure:
    """Half the width of the first problem's bounds against nodes and against time."""
    styles = {1: "--", 2: "-"}
    curves = [
        (method, order, {"linestyle": style, "label": f"{method}, order {order}"})
        for (order, style), method in product(styles.items(), METHODS)
    ]
    sheet, left = side_by_side(rows, cases(rows)[0], curves)
    left.set(ylabel="half the width of the force's bounds [%]")
    return finished(sheet, "nodes of the displacement")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the table and the figure."""
    parser = command_line(__doc__, out="results/bounds")
    parser.add_argument("problems", nargs="+", metavar="FILE.toml")
    parser.add_argument("--levels", type=int, default=3, help="meshes of each problem; default: 3")
    options = parser.parse_args(arguments)
    warm_up()
    store = Store(options.out / "rows.jsonl")
    for path in options.problems:
        problem = load_problem(path)
        free = replace(problem, motion=replace(problem.motion, delta=None, pinned=()))
        for task in tasks(free, options.levels):
            measure(store, free.name, *task)
    written(options.out, [table(store.rows)], picture(store.rows), "force_bounds.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
