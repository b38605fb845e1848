"""Is relocation worth it? Error against nodes and time, without boxes, beside what else could be done.

    python scripts/benchmark_worth.py                              Example 6.1 with 8, 16, 32 squares a side
    python scripts/benchmark_worth.py --cases L-shape 6.3 wedge    other problems
    python scripts/benchmark_worth.py --acceptance 0.13            `rmesh solve` on a gmsh part of 5,000 nodes
    python scripts/benchmark_worth.py --large 128                  one large mesh: time and memory

Uniform grids, h-adaptive meshes (with the exact errors as an oracle, with a residual estimator), boxes, large
moves without and with flips, hr. Cases: 6.1, L-shape, 6.3, wedge, free boundary, plate, Hertz, Signorini
(scripts/worth/cases.py). Errors are those of the energy by a rule of degree 10, against the exact one or that
of a locally refined mesh; of free boundary, Hertz and Signorini half the square of the error in the energy
norm. Programs use degree 6.

Rows are kept in DIR/rows.jsonl: run again, it measures only what is missing. Writes DIR/goals.md,
DIR/rows.md and DIR/worth.png from all rows that are there; `--page docs/large_moves.md` puts the table and
the figure into the page.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).resolve().parent
sys.path[:0] = [str(path) for path in (SCRIPTS, SCRIPTS / "gallery") if str(path) not in sys.path]

from worth import methods  # noqa: E402
from worth.acceptance import accepted  # noqa: E402
from worth.cases import CASES, Case  # noqa: E402
from worth.goals import goals, on_page, table  # noqa: E402
from worth.picture import picture  # noqa: E402
from worth.rows import Row, Store  # noqa: E402

from support.formulations import auto  # noqa: E402
from rmesh_nlp.programs.refinement import residual_indicators  # noqa: E402

ALL = ("uniform", "oracle", "residual", "boxes", "large", "flips", "hr")
USUAL = ("uniform", "oracle", "large", "flips")


def measure(store: Store, case: Case, names: Sequence[str], sizes: Sequence[int]) -> None:
    """The methods on a case at some sizes; a problem is stated only where something is missing."""
    most = int(case.problem(max(sizes)).mesh.p.shape[1])
    oracle, residual = "h-adaptive, oracle", "h-adaptive, residual estimator"

    def keep(method: str, size: int, rows: Iterator[Row]) -> None:
        store.measured(case.name, method, str(size), lambda: rows)

    if "oracle" in names:
        keep(oracle, most, methods.adaptive(case, oracle, case.local, most))
    if "residual" in names:
        keep(residual, most, methods.adaptive(case, residual, residual_indicators, most))
    if "hr" in names:
        keep("hr", most // 2, methods.refined_and_relocated(case, most // 2))
    for size in sizes:
        if "uniform" in names:
            keep("uniform", size, methods.uniform(case, size))
        if "boxes" in names:
            keep("boxes", size, methods.boxes(case, size))
        if "large" in names:
            keep("large moves", size, methods.large(case, size, False))
        if "flips" in names:
            keep("large moves, flips", size, methods.large(case, size, True))


def large_mesh(n: int) -> Iterator[Row]:
    """Example 6.1 on a large mesh by `auto`: wall time and peak memory of this process."""
    case = CASES["6.1"]
    problem = case.problem(n)
    began, spent = time.perf_counter(), time.process_time()
    solution = auto.solve(problem)
    seconds, spent = time.perf_counter() - began, time.process_time() - spent
    assert problem.exact is not None
    before, after = (
        energy - problem.exact.energy
        for energy in (solution.energy_initial_audited, solution.audit.energy_audited)
    )
    figures = {
        "triangles": int(problem.mesh.t.shape[1]),
        "factor": before / after,
        "processor_seconds": spent,
        "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "success": solution.success,
        "status": solution.status.value,
        "contact_solves": solution.contact_solves,
    }
    nodes, area = int(problem.mesh.p.shape[1]), float(solution.audit.min_area_ratio)
    yield Row("large", "large moves", str(n), nodes, after, seconds, least_area=area, figures=figures)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the tables and the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", nargs="*", choices=sorted(CASES), help="6.1, if nothing else is asked for")
    parser.add_argument("--methods", nargs="+", choices=ALL, help="all on 6.1; four elsewhere")
    parser.add_argument("--sizes", type=int, nargs="+", help="of the cases; 8 16 32 squares a side on 6.1")
    parser.add_argument("--acceptance", type=float, nargs="*", default=[], help="edge lengths of the part")
    parser.add_argument("--large", type=int, nargs="*", default=[], help="squares a side of a large mesh")
    parser.add_argument("--out", type=Path, default=Path("results/worth"), help="folder")
    parser.add_argument("--page", type=Path, help="docs/large_moves.md: its table and figure are made anew")
    given = parser.parse_args(arguments)
    store = Store(given.out / "rows.jsonl")
    other = given.acceptance or given.large or given.page or given.cases is not None
    for name in given.cases or ([] if other else ["6.1"]):
        case = CASES[name]
        sizes = sorted(given.sizes or (case.sizes[:3] if name == "6.1" else case.sizes))
        measure(store, case, given.methods or (ALL if name == "6.1" else USUAL), sizes)
    for h in given.acceptance:
        folder = given.out / f"part_{h:g}"
        store.measured("acceptance", "rmesh solve", f"{h:g}", lambda h=h, folder=folder: accepted(h, folder))
    for n in given.large:
        store.measured("large", "large moves", str(n), lambda n=n: large_mesh(n))
    (given.out / "goals.md").write_text(goals(store.rows))
    (given.out / "rows.md").write_text(table(store.rows))
    if any(row.case == "6.1" for row in store.rows):
        picture(store.rows).savefig(given.out / "worth.png", dpi=110)
    if given.page is not None:
        given.page.write_text(on_page(given.page.read_text(), store.rows))
        picture(store.rows).savefig(given.page.parent / "worth.png", dpi=110)
    print(goals(store.rows))
    return 0 if all(np.isfinite(row.error) for row in store.rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
