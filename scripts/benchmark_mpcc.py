"""The MPCC solver beside a plain Scholtes loop: a collection, generated families, and starts where it missed.

    python scripts/benchmark_mpcc.py mpcc_problems.py --families all --out results
    python scripts/benchmark_mpcc.py mpcc_problems.py --relaxation kanzow-schwartz --multistart 10

The collection is a Python file with ``names()`` and ``get(name)``; ``get`` returns a dict with
``x f g G H lbx ubx lbg ubg x0 target`` (CasADi expressions, bounds, a start, the best known value). Without
``--multistart`` the command ``rmesh mpcc --benchmark`` says the same.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc import RELAXATIONS, Options, multistart
from rmesh_nlp.mpcc.benchmark import REACHED, at_target, from_families, from_files, markdown, run, table
from rmesh_nlp.mpcc.reading import Problem, as_mpcc
from rmesh_nlp.mpcc.reading import load_collection as load

__all__ = ["as_mpcc", "load", "main", "plain_loop_result", "relative_error"]

PLAIN_IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "bound_relax_factor": 0.0,
    "mu_strategy": "adaptive",
    "mu_oracle": "quality-function",
    "tol": 1e-10,
}


def relative_error(f: float, target: float) -> float:
    """Error relative to max(1, |target|)."""
    return abs(f - target) / max(1.0, abs(target))


def plain_loop_result(problem: Mapping[str, Any]) -> dict[str, ca.DM]:
    """Scholtes' relaxation in a plain loop of nlpsol calls; returns what the last one did."""
    G, H, t = problem["G"], problem["H"], type(problem["x"]).sym("t")
    n = G.shape[0]
    nlp = {
        "x": problem["x"],
        "p": t,
        "f": problem["f"],
        "g": ca.vertcat(problem["g"], G, H, G * H - t),
    }
    settings = {
        "ipopt": PLAIN_IPOPT,
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,
    }
    solver = ca.nlpsol("plain", "ipopt", nlp, settings)
    lower = np.concatenate([problem["lbg"], np.zeros(2 * n), np.full(n, -np.inf)])
    upper = np.concatenate([problem["ubg"], np.full(2 * n, np.inf), np.zeros(n)])
    x = problem["x0"]
    for k in range(11):
        answer = solver(x0=x, p=10.0**-k, lbx=problem["lbx"], ubx=problem["ubx"], lbg=lower, ubg=upper)
        x = answer["x"]
    return answer


def print_multistart(problem: Problem, n: int, seed: int, options: Options) -> None:
    """Multi-start a problem that missed its target."""
    outcome = multistart(problem.mpcc, problem.x0, n=n, seed=seed, options=options)
    found = "found" if at_target(outcome.best.f, problem.target) else "missed"
    print(f"{problem.name}: {found} (target {problem.target:.7g}): {outcome}")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, run, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("collection", type=Path, help="Python file with names() and get(name)")
    parser.add_argument("--only", help="comma-separated problem names of the collection")
    parser.add_argument("--families", help="generated problems beside it: all, chosen, held-out, or names")
    parser.add_argument("--sizes", type=int, default=2, help="sizes of each family")
    parser.add_argument("--seeds", type=int, default=3, help="problems of each size")
    parser.add_argument("--relaxation", default="scholtes", choices=list(RELAXATIONS))
    parser.add_argument(
        "--multistart", type=int, default=0, metavar="N", help="N starts where the target is missed"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the multi-starts")
    parser.add_argument("--no-plain", action="store_true", help="skip the plain loop")
    parser.add_argument("--out", type=Path, help="folder for records, table and profile")
    given = parser.parse_args(arguments)
    try:
        known = list(from_files([given.collection]))
    except ValueError as error:
        raise SystemExit(str(error)) from None
    names = given.only.split(",") if given.only else [problem.name for _, problem in known]
    unknown = set(names) - {problem.name for _, problem in known}
    if unknown:
        parser.error(f"no such problem: {', '.join(sorted(unknown))}")
    chosen = [(group, problem) for group, problem in known if problem.name in names]
    families = from_families(given.families.split(","), given.sizes, given.seeds) if given.families else ()
    warm = ca.SX.sym("warm")  # loading Ipopt's library is nobody's cost
    ca.nlpsol("warm", "ipopt", {"x": warm, "f": warm**2}, {"ipopt": PLAIN_IPOPT, "print_time": False})(x0=1)
    options = Options(relaxation=given.relaxation)
    rows = run(
        itertools.chain(chosen, families), options, plain=not given.no_plain, out=given.out, show=print
    )
    print("\n" + markdown(table(rows)))
    missed = [
        problem for row, (_, problem) in zip(rows, chosen, strict=False) if not row.get("reached", True)
    ]
    reached, successes = len(chosen) - len(missed), sum(row["success"] for row in rows[: len(chosen)])
    print(f"\n{reached} of {len(chosen)} within {REACHED:g} of the target, {successes} successes")
    if given.multistart:
        print(f"\nmulti-start, {given.multistart} starts, seed {given.seed}")
        for problem in missed:
            print_multistart(problem, given.multistart, given.seed, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
