"""Run the MPCC solver over a collection of problems and compare it with a plain Scholtes loop.

The collection is a Python file with ``names()`` and ``get(name)``; ``get`` returns a dict with
``x f g G H lbx ubx lbg ubg x0 target`` (CasADi expressions, bounds, a start, the best known value)::

    python scripts/benchmark_mpcc.py mpcc_problems.py
    python scripts/benchmark_mpcc.py mpcc_problems.py --relaxation kanzow-schwartz --multistart 10

The plain loop is what one writes first: one nlpsol with ``G H <= t``, t from 1 to 1e-10 by 0.1, each solve
started from the one before. Both are timed with everything they build.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc import MPCC, RELAXATIONS, MPCCResult, multistart, solve

PLAIN_IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "bound_relax_factor": 0.0,
    "mu_strategy": "adaptive",
    "mu_oracle": "quality-function",
    "tol": 1e-10,
}
REACHED = 1e-4  # relative to max(1, |target|)


@dataclass(frozen=True, eq=False)
class Row:
    """One problem: ours, and the plain loop's value and time."""

    name: str
    target: float
    result: MPCCResult
    seconds: float
    plain_f: float
    plain_seconds: float

    @property
    def error(self) -> float:
        """Relative error of the objective."""
        return relative_error(self.result.f, self.target)

    def line(self) -> str:
        """One line of the table."""
        r = self.result
        b = {True: "B", False: "-", None: "?"}[r.b_stationary]
        flag = "" if self.error <= REACHED else " *"
        return (
            f"{self.name:16} {self.target:14.7g} {r.f:14.7g} {self.error:8.1e} "
            f"{r.constraint_violation:8.1e} {r.complementarity:8.1e} {r.stationarity or '?':>4} {b} "
            f"{len(r.biactive):3d} {r.status.value:>16} {self.seconds:7.3f} "
            f"{r.counts['ipopt_iterations']:5d} {self.plain_f:14.7g} {self.plain_seconds:7.3f}{flag}"
        )


HEADER = (
    f"{'problem':16} {'target':>14} {'f':>14} {'error':>8} {'viol':>8} {'max min':>8} stat B  bi "
    f"{'status':>16} {'s':>7} {'iter':>5} {'plain f':>14} {'plain s':>7}"
)


def relative_error(f: float, target: float) -> float:
    """Error relative to max(1, |target|)."""
    return abs(f - target) / max(1.0, abs(target))


def load(path: Path) -> ModuleType:
    """Import a collection from a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise SystemExit(f"{path} is not a Python file")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)  # dataclasses look there
    spec.loader.exec_module(module)
    return module


def as_mpcc(problem: Mapping[str, Any]) -> MPCC:
    """The MPCC of a problem of the collection."""
    return MPCC(**{key: problem[key] for key in ("x", "f", "g", "G", "H", "lbx", "ubx", "lbg", "ubg")})


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


def run(name: str, problem: Mapping[str, Any], relaxation: str, plain: bool) -> Row:
    """Solve one problem both ways."""
    began = time.perf_counter()
    plain_f = float(plain_loop_result(problem)["f"]) if plain else float("nan")
    plain_seconds = time.perf_counter() - began
    began = time.perf_counter()
    result = solve(as_mpcc(problem), problem["x0"], relaxation=relaxation)
    return Row(name, problem["target"], result, time.perf_counter() - began, plain_f, plain_seconds)


def print_summary(rows: list[Row], plain: bool) -> None:
    """Totals of the table."""
    reached = [row for row in rows if row.error <= REACHED]
    ours, theirs = sum(row.seconds for row in rows), sum(row.plain_seconds for row in rows)
    successes = [row.result for row in rows if row.result.success]
    print(f"\n{len(reached)} of {len(rows)} within {REACHED:g} of the target, {len(successes)} successes")
    for name in ("complementarity", "constraint_violation"):
        worst = max((getattr(result, name) for result in successes), default=0.0)
        print(f"largest {name} of a success: {worst:.1e}")
    for row in rows:
        if row.error > REACHED:
            print(f"not at the target: {row.name} (target {row.target:.7g}): {row.result}")
    print(f"time {ours:.2f} s, {sum(r.result.counts['ipopt_iterations'] for r in rows)} Ipopt iterations")
    if plain:
        hits = sum(relative_error(row.plain_f, row.target) <= REACHED for row in rows)
        print(f"plain loop {theirs:.2f} s, {hits} within the same error; ratio of times {theirs / ours:.2f}")


def print_multistart(rows: list[Row], module: ModuleType, n: int, seed: int, relaxation: str) -> None:
    """Multi-start the problems that missed their target."""
    print(f"\nmulti-start, {n} starts, seed {seed}")
    for row in rows:
        if row.error > REACHED:
            problem = module.get(row.name)
            outcome = multistart(as_mpcc(problem), problem["x0"], n=n, seed=seed, relaxation=relaxation)
            found = "found" if relative_error(outcome.best.f, row.target) <= REACHED else "missed"
            print(f"{row.name}: {found} (target {row.target:.7g}): {outcome}")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, run, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("collection", type=Path, help="Python file with names() and get(name)")
    parser.add_argument("--only", help="comma-separated problem names")
    parser.add_argument("--relaxation", default="scholtes", choices=list(RELAXATIONS))
    parser.add_argument(
        "--multistart", type=int, default=0, metavar="N", help="N starts where the target is missed"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-plain", action="store_true", help="skip the plain loop")
    options = parser.parse_args(arguments)
    module = load(options.collection)
    names = options.only.split(",") if options.only else module.names()
    unknown = set(names) - set(module.names())
    if unknown:
        parser.error(f"no such problem: {', '.join(sorted(unknown))}")
    warm = ca.SX.sym("warm")  # loading Ipopt's library is nobody's cost
    ca.nlpsol("warm", "ipopt", {"x": warm, "f": warm**2}, {"ipopt": PLAIN_IPOPT, "print_time": False})(x0=1)
    print(HEADER)
    rows = []
    for name in names:
        rows.append(run(name, module.get(name), options.relaxation, not options.no_plain))
        print(rows[-1].line(), flush=True)
    print_summary(rows, not options.no_plain)
    if options.multistart:
        print_multistart(rows, module, options.multistart, options.seed, options.relaxation)
    return 0


if __name__ == "__main__":
    sys.exit(main())
