"""Which mesh is best: given, relocated, h-adaptive, or quadratic elements? Error against nodes and time.

    python scripts/benchmark_mesh.py                     every problem (12 minutes)
    python scripts/benchmark_mesh.py --cases 6.1 L-shape --levels 2

Relocation has no move limits but where it is said. The h-adaptive loop is a plain one of scikit-fem
(``best_mesh/adaptive.py``) on Example 6.1 and the L-shape; on the others triangles are marked by their
exact errors, which nobody knows beforehand, and no time is given. Errors are those of the energy, against
the exact one or that of a locally refined mesh; of free boundary and Signorini half the square of the
error in the energy norm. Rows are kept in DIR/rows.jsonl: run again, it measures only what is missing.
Writes DIR/table.md and DIR/best_mesh.png.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).resolve().parent
sys.path[:0] = [str(path) for path in (SCRIPTS, SCRIPTS / "gallery") if str(path) not in sys.path]

from best_mesh import methods  # noqa: E402
from best_mesh.cases import CASES, Case  # noqa: E402
from best_mesh.rows import ADAPTIVE, GIVEN, Row, Store, picture, table  # noqa: E402


def tasks(case: Case, sizes: Sequence[int]) -> Iterator[tuple[str, int, Callable[[], Iterator[Row]]]]:
    """Method, size and how to measure it."""
    most = int(case.problem(max(sizes)).mesh.p.shape[1])
    if case.laplacian is not None:
        most *= 3  # to the errors of relocated meshes
    yield ADAPTIVE, most, partial(methods.h_adaptive, case, most)
    for size in sizes:
        yield GIVEN, size, partial(methods.given, case, size)
    for size in sizes if case.name == "6.1" else ():
        if size <= 32:  # minutes beyond
            yield "relocated, move limits", size, partial(methods.move_limits, case, size)
    for size in sizes:
        yield "relocated", size, partial(methods.relocated, case, size, False)
    for size in sizes:
        yield "remeshed, relocated", size, partial(methods.relocated, case, size, True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the table and the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--levels", type=int, help="meshes of each problem, the coarsest ones; default: all")
    parser.add_argument("--out", type=Path, default=Path("results/mesh"), help="folder")
    options = parser.parse_args(arguments)
    store = Store(options.out / "rows.jsonl")
    methods.warm_up()
    for case in (CASES[name] for name in options.cases):
        for method, size, measure in tasks(case, case.sizes[: options.levels]):
            if not store.has(case.name, method, str(size)):
                store.keep(measure())
    (options.out / "table.md").write_text(table(store.rows))
    picture(store.rows).savefig(options.out / "best_mesh.png", dpi=110)
    print(table(store.rows))
    return 0 if all(np.isfinite(row.error) for row in store.rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
