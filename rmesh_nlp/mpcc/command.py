"""The command ``python -m rmesh_nlp.mpcc``, which is also ``rmesh mpcc``."""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rmesh_nlp.mpcc.benchmark import files, from_families, from_files, markdown, run, table
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.reading import read
from rmesh_nlp.mpcc.relaxations import RELAXATIONS
from rmesh_nlp.mpcc.solver import solve

_ABOUT = """Solve mathematical programs with complementarity constraints from files: AMPL .nl, and .json
with CasADi Functions as NOSBENCH writes them. The exit code is 0 only if every solve succeeded."""
_EXAMPLES = """examples:
  rmesh mpcc problem.nl
  rmesh mpcc problem.nl --relaxation kanzow-schwartz --time-limit 30 --log
  rmesh mpcc --benchmark collection/ --out results
  rmesh mpcc --families held-out --seeds 5 --out results
  rmesh mpcc --benchmark collection.py --families all --out results
"""


def parser() -> argparse.ArgumentParser:
    """The options of the command."""
    options = argparse.ArgumentParser(
        prog="rmesh mpcc", description=_ABOUT, epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = options.add_argument
    add("paths", nargs="*", type=Path, metavar="FILE", help="with --benchmark folders too")
    add("--relaxation", default="scholtes", choices=list(RELAXATIONS))
    add("--time-limit", type=float, metavar="S", help="seconds per problem (none)")
    add("--max-iterations", type=int, metavar="N", help="Ipopt iterations per problem (no limit)")
    add("--log", action="store_true", help="a line per nonlinear program")
    add("--json", action="store_true", help="a JSON object per problem, with the solution")
    add(
        "--benchmark",
        action="store_true",
        help="compare with a plain loop of nlpsol; FILE may also be a Python file with names() and get(name)",
    )
    add("--families", metavar="NAMES", help="generated problems: all, chosen, held-out, or names")
    add("--sizes", type=int, default=2, metavar="N", help="sizes of each family (2)")
    add("--seeds", type=int, default=3, metavar="N", help="problems of each size (3)")
    add("--no-plain", action="store_true", help="leave the plain loop out")
    add("--out", type=Path, metavar="DIR", help="write records, table and profile there")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 if every solve succeeded, 1 if one did not, 2 for bad input."""
    given = parser().parse_args(arguments)
    try:
        settings = _settings(given)
        if given.benchmark or given.families:
            return _benchmark(given, settings)
        if not given.paths:
            raise ValueError("no file given; see rmesh mpcc --help")
        return max(_solve(path, given, settings) for path in given.paths)
    except (ValueError, OSError, ImportError) as error:
        print(f"rmesh mpcc: {' '.join(str(error).split())}", file=sys.stderr)
        return 2


def _settings(given: argparse.Namespace) -> Options:
    changes = {"relaxation": given.relaxation, "max_iterations": given.max_iterations}
    if given.time_limit is not None:
        changes["time_limit_s"] = given.time_limit
    for name in ("sizes", "seeds"):
        if getattr(given, name) < 1:
            raise ValueError(f"--{name} {getattr(given, name)}: at least 1 is needed")
    return Options(**changes)


def _solve(path: Path, given: argparse.Namespace, settings: Options) -> int:
    """Solve one file and print status, label, residuals."""
    problem = read(path)
    result = solve(problem.mpcc, problem.x0, p=problem.p0, options=settings, progress=given.log)
    f = problem.sign * result.f
    if given.json:
        words = {
            "problem": problem.name, "status": result.status.value, "success": result.success, "f": f,
            "constraint_violation": result.constraint_violation, "complementarity": result.complementarity,
            "stationarity": result.stationarity, "n_biactive": result.n_biactive,
            "b_stationary": result.b_stationary, "iterations": result.counts["ipopt_iterations"],
            "seconds": result.seconds["total"], "x": result.x[: problem.mpcc.n_own].tolist(),
        }  # fmt: skip
        print(json.dumps(words))
    else:
        sizes = f"{problem.mpcc.n_own} unknowns, {problem.mpcc.n_g} rows, {problem.mpcc.n_pairs} pairs"
        residuals = f"violation {result.constraint_violation:.1e}, min(G, H) {result.complementarity:.1e}"
        counts = f"{result.counts['ipopt_iterations']} iterations in {result.counts['nlp_solves']} steps"
        print(f"{problem.name}: {sizes}")
        print(f"  status           {result.status.value}: {result.message}")
        print(f"  objective        {f:.12g}")
        print(f"  stationarity     {result.label}")
        print(f"  residuals        {residuals}")
        print(f"  cost             {counts}, {result.seconds['total']:.2f} s")
    return 0 if result.success else 1


def _benchmark(given: argparse.Namespace, settings: Options) -> int:
    """Solve a collection beside the plain loop."""
    if given.paths and not given.benchmark:
        raise ValueError("files beside --families need --benchmark")
    problems = itertools.chain(
        from_families(given.families.split(","), given.sizes, given.seeds) if given.families else (),
        from_files(files(given.paths)),
    )
    rows = run(problems, settings, plain=not given.no_plain, out=given.out, show=_show)
    if not rows:
        raise ValueError("no file given; see rmesh mpcc --help")
    print("\n" + markdown(table(rows)))
    if given.out is not None:
        print(f"\nwritten to {given.out}")
    return 0 if all(row["success"] for row in rows) else 1


def _show(text: str) -> None:
    print(text, flush=True)
