"""Which mesh of N nodes is best? Error against nodes and processor time, beside peers and what is attainable.

    python scripts/benchmark_mesh.py                     every problem (15 minutes)
    python scripts/benchmark_mesh.py --cases 6.1 L-shape --levels 2
    python scripts/benchmark_mesh.py --predict           what ``rmesh advise`` predicts, on problems held out

Factors are errors of the given mesh over those of the method at equal nodes. Relocation has no move limits.
Peers: second-order elements on the given mesh, a plain h-adaptive loop of scikit-fem
(``best_mesh/adaptive.py``), and Mmg with the recovered metric, whose nodes are not relocated. Elastic bodies
but the wedge, and the membrane, are refined by the package where the interpolation error is, without a time.
Errors are those of the assessed energy on the domain of the true curves, against the exact one or that of a
locally refined mesh; of free boundary, Signorini and jNO's L-shape half the square of the error in the energy
norm.
Attainable is the interpolation error of as many triangles of the best shapes.
Rows are kept in DIR/rows.jsonl: run again, it measures only what is missing. Writes DIR/table.md and
DIR/best_mesh.png.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).resolve().parent
sys.path[:0] = [str(path) for path in (SCRIPTS, SCRIPTS / "gallery") if str(path) not in sys.path]

from best_mesh import methods, predict  # noqa: E402
from best_mesh.cases import CASES, Case  # noqa: E402
from best_mesh.rows import (  # noqa: E402
    ADAPTIVE,
    ATTAINABLE,
    GIVEN,
    LOOP,
    METRIC,
    RELOCATED,
    REMESHED,
    Row,
    Store,
    picture,
    table,
    times,
)


def tasks(case: Case, sizes: Sequence[int]) -> Iterator[tuple[str, int, Callable[[], Iterator[Row]]]]:
    """Method, size and how to measure it."""
    most = int(case.problem(max(sizes)).mesh.p.shape[1])
    plain = case.equations is not None  # cheap, and followed to the errors of relocated meshes
    yield ADAPTIVE, most, partial(methods.h_adaptive, case, max(8 * most, 10_000) if plain else most)
    yield LOOP, most, partial(methods.metric_loop, case, max(2 * most, 6_000) if plain else most)
    for size in sizes:
        yield GIVEN, size, partial(methods.given, case, size)
        yield ATTAINABLE, size, partial(methods.attainable, case, size)
        yield METRIC, size, partial(methods.metric, case, size)
        yield RELOCATED, size, partial(methods.relocated, case, RELOCATED, size, False)
        yield REMESHED, size, partial(methods.relocated, case, REMESHED, size, True)


def attempted(measure: Callable[[], Iterator[Row]], failed: Row) -> list[Row]:
    """The rows, or one that says what went wrong."""
    try:
        return [replace(row, size=failed.size) for row in measure()]
    except Exception as error:
        return [replace(failed, status=f"{type(error).__name__}: {error}")]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the table and the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--levels", type=int, help="meshes of each problem, the coarsest ones; default: all")
    parser.add_argument(
        "--predict", action="store_true", help="compare predicted with measured factors instead"
    )
    parser.add_argument("--out", type=Path, default=Path("results/mesh"), help="folder")
    options = parser.parse_args(arguments)
    methods.warm_up()
    if options.predict:
        store = Store(options.out / "predicted.jsonl")
        for seed in predict.SEEDS:
            if predict.known(store.rows) < predict.COUNT and not store.has(f"random {seed}", GIVEN, seed):
                failed = Row(f"random {seed}", GIVEN, seed, 0, float("nan"))
                store.keep(attempted(partial(predict.measured, seed), failed))
        (options.out / "predicted.md").write_text(predict.summary(store.rows))
        print(predict.summary(store.rows))
        return 0
    store = Store(options.out / "rows.jsonl")
    for case in (CASES[name] for name in options.cases):
        for method, size, measure in tasks(case, case.sizes[: options.levels]):
            if not store.has(case.name, method, size):
                store.keep(attempted(measure, Row(case.name, method, size, 0, float("nan"))))
    goals = {
        (case.name, size): goal
        for case in CASES.values()
        for size, goal in zip(case.sizes, case.goals, strict=False)
    }
    text = table(store.rows, goals) + "\n" + times(store.rows)
    (options.out / "table.md").write_text(text)
    picture(store.rows).savefig(options.out / "best_mesh.png", dpi=110)
    print(text)
    return 0 if all(np.isfinite(row.error) for row in store.rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
