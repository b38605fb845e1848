"""What relocation gains at order 2: error against unknowns and processor time, beside order 1 and peers.

    python scripts/benchmark_order.py                    every problem (an hour)
    python scripts/benchmark_order.py --cases 6.1 wedge --levels 2
    python scripts/benchmark_order.py --tables           of what was measured, nothing more

For displacements of orders 1 and 2 with as many unknown nodes (vertices, and at order 2 middles of edges):
the uniform mesh, an h-adaptive loop, relocation by ``auto`` with the connectivity of that mesh, and on a new
mesh. Uniform meshes and the loop are scikit-fem's own where ``best_mesh/adaptive.py`` has the problem; else
the package solves and refines, and the loop has no time.
Errors are those of the assessed energy, of the L-shape and Signorini's problem half the square of the error
in the energy norm. Energies that are not known are extrapolated from two meshes made for order 2, with errors
like one over the square of the number of nodes.
Rows are kept in DIR/rows.jsonl: run again, it measures only what is missing. Writes DIR/table.md and
DIR/order.png.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).resolve().parent
sys.path[:0] = [str(path) for path in (SCRIPTS, SCRIPTS / "gallery") if str(path) not in sys.path]

from skfem import MeshTri  # noqa: E402

from benchmark_mesh import attempted  # noqa: E402
from best_mesh import adaptive as plain  # noqa: E402
from best_mesh import methods, order_tables  # noqa: E402
from best_mesh.cases import CASES, MORE, Case, next_mesh  # noqa: E402
from best_mesh.order_tables import ADAPTIVE, POLYGON, REFERENCE, RELOCATED, REMESHED, UNIFORM  # noqa: E402
from best_mesh.rows import Row, Store  # noqa: E402
from rmesh_nlp.fem.space import DisplacementSpace  # noqa: E402
from rmesh_nlp.models.remeshing import Solved, metric_start  # noqa: E402
from rmesh_nlp.problem import ContactProblem, Motion  # noqa: E402

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

MOST = {UNIFORM: 80_000, ADAPTIVE: 30_000}
"""Nodes up to which meshes of scikit-fem go."""

FINE = (1500, 3000)
"""Vertices of the meshes that an energy is extrapolated from."""


def tasks(case: Case, levels: int | None) -> Iterator[tuple[str, int, Callable[[], Iterator[Row]]]]:
    """Method, size and how to measure it."""
    sizes = SIZES[case.name]
    for order in (2, 1):
        here = sizes[2 - order : len(sizes) + 1 - order][:levels]
        if case.equations is not None:
            for method, loop in ((UNIFORM, plain.uniform), (ADAPTIVE, plain.adaptive)):
                yield f"P{order} {method}", 0, partial(by_scikit_fem, case, here[0], order, method, loop)
        else:
            yield f"P{order} {ADAPTIVE}", 0, partial(refined, case, here, order)
            for size in (*here, *sizes[len(here) + 2 - order :][:1]):
                yield f"P{order} {UNIFORM}", size, partial(uniform, case, size, order)
        for size in here:
            for method in (RELOCATED, REMESHED):
                yield f"P{order} {method}", size, partial(relocated, case, size, order, method)


def by_scikit_fem(
    case: Case, size: int, order: int, method: str, loop: Callable[..., Iterator[plain.Solved]]
) -> Iterator[Row]:
    """Uniform or h-adaptive refinement of the coarsest mesh."""
    mesh = case.problem(size).mesh
    assert case.equations is not None
    for found in loop(case.equations, MeshTri(mesh.p, mesh.t), order, MOST[method]):
        yield Row(case.name, f"P{order} {method}", 0, found.nodes, case.error_of(found), found.seconds)


def refined(case: Case, sizes: Sequence[int], order: int) -> Iterator[Row]:
    """Local refinement by the package to as many nodes as the finest mesh has, without a time."""
    problem, enough = of_order(case, sizes[0], order), unknowns(of_order(case, sizes[-1], order))
    while True:
        yield Row(case.name, f"P{order} {ADAPTIVE}", 0, unknowns(problem), case.error(problem))
        if unknowns(problem) >= enough:
            return
        problem = next_mesh(problem)


def uniform(case: Case, size: int, order: int) -> Iterator[Row]:
    """The mesh as given, solved by the package."""
    problem = of_order(case, size, order)
    began = time.process_time()
    Solved.of(problem)
    seconds = time.process_time() - began
    yield Row(case.name, f"P{order} {UNIFORM}", size, unknowns(problem), case.error(problem), seconds)


def relocated(case: Case, size: int, order: int, method: str) -> Iterator[Row]:
    """By ``auto`` on the mesh as given, or on one for the solution."""
    final, seconds, status = methods.by_default(of_order(case, size, order), method == REMESHED)
    yield Row(case.name, f"P{order} {method}", size, unknowns(final), case.error(final), seconds, status)


def of_order(case: Case, size: int, order: int) -> ContactProblem:
    """The problem of a case, with displacements of an order."""
    return replace(case.problem(size), order=order)


def unknowns(problem: ContactProblem) -> int:
    """Number of displacement nodes."""
    return int(DisplacementSpace.of(problem).n_nodes)


def energies(name: str, problem: ContactProblem, method: str) -> Iterator[Row]:
    """Energies of the contact solutions of two meshes made for order 2.

    Not the assessed ones: over a curved obstacle in the interior, stand-offs are the larger error there.
    """
    solved = Solved.of(replace(problem, order=2, exact=None, reference=None))
    for vertices in FINE:
        solved = metric_start(solved, vertices).solved
        energy = solved.state.energy
        yield Row(name, method, vertices, unknowns(solved.problem), energy, status="energy")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the tables and the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--levels", type=int, help="meshes of each problem, the coarsest ones; default: all")
    parser.add_argument("--tables", action="store_true", help="of what was measured")
    parser.add_argument("--out", type=Path, default=Path("results/order"), help="folder")
    options = parser.parse_args(arguments)
    store = Store(options.out / "rows.jsonl")
    if not options.tables:
        methods.warm_up()
        for name in options.cases:
            measure(store, {**CASES, **MORE}[name], options.levels)
    text = order_tables.tables(store.rows)
    (options.out / "table.md").write_text(text)
    order_tables.picture(store.rows).savefig(options.out / "order.png", dpi=110)
    print(text)
    return 0 if all(np.isfinite(row.error) for row in store.rows) else 1


def measure(store: Store, case: Case, levels: int | None) -> None:
    """What is missing of a case, its energy first."""

    def keep(method: str, size: int, one: Callable[[], Iterator[Row]]) -> None:
        if not store.has(case.name, method, size):
            store.keep(attempted(one, Row(case.name, method, size, 0, float("nan"))))

    sizes = SIZES[case.name]
    if case.slope is None and case.name != "6.1":
        keep(REFERENCE, 0, partial(energies, case.name, case.problem(sizes[0]), REFERENCE))
        limit = order_tables.limit(store.rows, case.name, REFERENCE, 0)[0]
        case = replace(case, exact=lambda: limit)
    if case.problem(sizes[0]).motion.curves:
        for size in sizes[:-1][:levels]:
            polygon = replace(case.problem(size), motion=Motion(None))
            keep(POLYGON, size, partial(energies, case.name, polygon, POLYGON))
    for method, size, one in tasks(case, levels):
        keep(method, size, one)


if __name__ == "__main__":
    raise SystemExit(main())
