"""Assembled derivatives against CasADi's automatic ones, on the same NLP in one run.

    python scripts/benchmark_assembly.py --n 16 32 64

Solves ``joint`` on Example 6.1 (delta = 0.22/n) twice with the same Ipopt options: with the
element Functions mapped and assembled by this package, and with everything derived by
``nlpsol``. Build is all that comes before Ipopt's first iteration. The plain run is the slow one:
minutes at n = 64.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import NLPResult, Solver
from rmesh_nlp.programs.energy_program import relocation
from rmesh_nlp.solving.referee import Referee

OPTIONS = {"max_iter": 3000}


@dataclass(frozen=True)
class Run:
    """Seconds to build and to solve, and the result."""

    build: float
    solve: float
    result: NLPResult

    @property
    def total(self) -> float:
        """Build and solve."""
        return self.build + self.solve


def run(n: int, *, assembled: bool) -> Run:
    """Build and solve ``joint`` on an n x n grid."""
    referee = Referee(EXAMPLES["6.1"](n))
    start = referee.reduced.point(np.zeros(referee.relocation.n_q), referee.initial)
    began = time.perf_counter()
    nlp: NLP = relocation(referee.problem).nlp
    solver = Solver(nlp if assembled else replace(nlp, derivatives=None), options=OPTIONS)
    build = time.perf_counter() - began
    result = solver(start)
    return Run(build, result.seconds, result)


def main() -> None:
    """Print one line per grid."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--n", type=int, nargs="+", default=[16, 32, 64], help="squares per side")
    sizes = parser.parse_args().n
    print(f"{'n':>4} {'build':>8} {'solve':>8} {'build/solve':>11} {'iter':>5} {'energy':>12}", end="")
    print(f" {'plain build':>12} {'plain solve':>12} {'iter':>5} {'energy':>12} {'ratio':>6}")
    for n in sizes:
        ours = run(n, assembled=True)
        print(
            f"{n:4d} {ours.build:7.2f}s {ours.solve:7.2f}s {ours.build / ours.solve:11.3f} "
            f"{ours.result.iterations:5d} {ours.result.f:12.7f}",
            end="",
            flush=True,
        )
        plain = run(n, assembled=False)
        print(
            f" {plain.build:11.2f}s {plain.solve:11.2f}s {plain.result.iterations:5d} {plain.result.f:12.7f} "
            f"{plain.total / ours.total:6.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
