"""The command ``rmesh-mpcc``, which is also ``rmesh mpcc`` and ``python -m rmesh_nlp.mpcc``."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from rmesh_nlp.mpcc import ampl
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.reading import read
from rmesh_nlp.mpcc.relaxations import RELAXATIONS
from rmesh_nlp.mpcc.solver import solve

_ABOUT = """Solve mathematical programs with complementarity constraints from files: AMPL .nl, and .json
with CasADi Functions as NOSBENCH writes them. The exit code is 0 only if every solve succeeded."""
_EXAMPLES = """examples:
  rmesh mpcc problem.nl
  rmesh mpcc problem.nl --relaxation kanzow-schwartz --time-limit 30 --log
  rmesh mpcc problem.nl --json > result.json
  rmesh-mpcc problem -AMPL relaxation=kanzow-schwartz time_limit_s=30    (writes problem.sol)
"""


class _Parser(argparse.ArgumentParser):
    """What is wrong is one line, without the usage before it."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message}; see rmesh mpcc --help")


def parser() -> argparse.ArgumentParser:
    """The options of the command."""
    options = _Parser(
        prog="rmesh mpcc", description=_ABOUT, epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = options.add_argument
    add("paths", nargs="*", type=Path, metavar="FILE")
    add("--relaxation", default="scholtes", choices=list(RELAXATIONS))
    add("--time-limit", type=float, default=float("inf"), metavar="S", help="seconds per problem (none)")
    add("--max-iterations", type=int, metavar="N", help="Ipopt iterations per problem (no limit)")
    add(
        "--starts",
        type=int,
        default=1,
        metavar="N",
        help="the lowest of N starts: the file's, random ones (1)",
    )
    add("--log", action="store_true", help="a line per nonlinear program")
    add("--json", action="store_true", help="a JSON object per problem, with the solution")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 if every solve succeeded, 1 if one did not, 2 for bad input, 130 if interrupted.

    Called as AMPL calls solvers (:func:`rmesh_nlp.mpcc.ampl.run`) it is 0 where a ``.sol`` file was written.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        if ampl.is_meant(words):
            return ampl.run(words)
        given = parser().parse_args(words)
        settings = Options(
            relaxation=given.relaxation, max_iterations=given.max_iterations, time_limit_s=given.time_limit,
            starts=given.starts,
        )  # fmt: skip
        if not given.paths:
            raise ValueError("no file given; see rmesh mpcc --help")
        return max(_solve(path, given, settings) for path in given.paths)
    except (ValueError, OSError, ImportError) as error:
        said = str(error)
        if isinstance(error, OSError) and error.filename:
            said = f"{error.filename}: {error.strerror}"
        print(f"rmesh mpcc: {' '.join(said.split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("rmesh mpcc: interrupted", file=sys.stderr)
        return 130


def _solve(path: Path, given: argparse.Namespace, settings: Options) -> int:
    """Solve one file and print status, label, residuals."""
    problem = read(path)
    result = solve(problem.mpcc, problem.x0, p=problem.p0, options=settings, progress=given.log)
    mpcc, f, seconds = problem.mpcc, problem.sign * result.f, result.seconds["total"]
    reached = [replace(end, f=problem.sign * end.f) for end in result.reached]
    iterations, solves = result.counts["ipopt_iterations"], result.counts["nlp_solves"]
    if given.json:
        words = {
            "problem": problem.name, "status": result.status.value, "success": result.success, "f": f,
            "constraint_violation": result.constraint_violation, "complementarity": result.complementarity,
            "stationarity": result.stationarity, "n_biactive": result.n_biactive,
            "b_stationary": result.b_stationary, "iterations": iterations, "seconds": seconds,
            "starts": [
                {"f": None if math.isnan(end.f) else end.f, "status": end.status.value, "number": end.starts}
                for end in reached
            ],
            "x": result.x[: mpcc.n_own].tolist(),
        }  # fmt: skip
        print(json.dumps(words))
    else:
        violation, complementarity = result.constraint_violation, result.complementarity
        print(f"{problem.name}: {mpcc.n_own} unknowns, {mpcc.n_g} rows, {mpcc.n_pairs} pairs")
        print(f"  status           {result.status.value}: {result.message}")
        print(f"  objective        {f:.12g}")
        print(f"  stationarity     {result.label}")
        print(f"  residuals        violation {violation:.1e}, min(G, H) {complementarity:.1e}")
        if reached:
            print(f"  starts           {'; '.join(map(str, reached))}")
        print(f"  cost             {iterations} iterations in {solves} steps, {seconds:.2f} s")
    return 0 if result.success else 1


if __name__ == "__main__":
    sys.exit(main())
