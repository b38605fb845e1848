"""What a whole solve costs, in contact solves of its mesh.

    python scripts/benchmark_cost.py                              Example 6.1 without move limits
    python scripts/benchmark_cost.py 6.1:8 wedge:12 --order 2    also problems of the benchmarks of meshes

Processor time of one thread. The unit is a contact solve of the mesh as given from nothing, assembly
included, measured before and after each solve. Libraries are loaded before. ``python -m cProfile -s
cumulative`` before the name of this script tells where the time goes.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence
from dataclasses import replace

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import numpy as np
import pandas as pd

import rmesh_nlp as rm
from best_mesh.cases import CASES, MORE
from best_mesh.methods import unassessed
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.problem import ContactProblem
from rows import command_line, markdown, timed


def problem(text: str, order: int = 1) -> ContactProblem:
    """``NAME:SIZE``, without move limits and without its exact solution."""
    name, _, size = text.partition(":")
    given = {**CASES, **MORE}[name].make(int(size))
    motion = replace(given.motion, delta=None)
    return replace(given, motion=motion, exact=None, reference=None, order=order)


def units(given: ContactProblem) -> list[float]:
    """Processor times of contact solves from nothing."""
    solver, seconds = ContactSolver(given), []
    while len(seconds) < 5 or (sum(seconds) < 0.2 and len(seconds) < 50):
        seconds.append(timed(solver.solve, np.asarray(given.mesh.p))[1])
    return seconds


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = command_line(__doc__)
    parser.add_argument("problems", nargs="*", default=["6.1:8", "6.1:16", "6.1:32", "6.1:64"])
    parser.add_argument("--order", type=int, choices=(1, 2), default=1, help="of displacements")
    parser.add_argument("--remesh", action="store_true", help="begin on a mesh for the solution")
    options = parser.parse_args(arguments)
    rm.solve(problem("6.1:2", options.order), remesh=options.remesh)
    lines = []
    for text in options.problems:
        given = problem(text, options.order)
        before = units(given)
        solution, seconds = timed(rm.solve, given, remesh=options.remesh)
        unit = statistics.median(before + units(given))
        line = {"problem": text, "nodes": given.mesh.p.shape[1], "unit, ms": 1e3 * unit}
        line |= {"factorisations": solution.trace.work.contact_factorisations}
        line |= {"energy": f"{solution.energy_audited:.8g}", "whole": seconds / unit}
        lines.append(line | {"without assessment": unassessed(seconds, solution) / unit})
    print(markdown(pd.DataFrame(lines)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
