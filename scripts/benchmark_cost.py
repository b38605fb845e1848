"""What a whole solve costs, in contact solves of its mesh, and where that goes.

    python scripts/benchmark_cost.py                              Example 6.1 without move limits
    python scripts/benchmark_cost.py 6.1:8 wedge:12 --order 2    also problems of the benchmarks of meshes

Processor time of one thread. The unit is a contact solve of the mesh as given from nothing, assembly
included, measured before and after each solve. Libraries are loaded before. The columns are exclusive.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import numpy as np
import pandas as pd

import rmesh_nlp as rm
from best_mesh.cases import CASES, MORE
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import ContactProblem
from rows import command_line, markdown, timed

PARTS = {
    "models": "contact.solver:ContactSolver models.reduced_model:ReducedEnergy "
    "models.second_derivatives:Curvature",
    "coarser": "models.levels:hierarchy models.levels:prolonged",
    "descents": "models.descent:descend",
    "metric": "models.remeshing:metric_start",
    "estimate": "models.regularisation:gain_estimate",
    "unit": "optimize.budget:timed",
    "assess": "solving.assess:assess",
    "reduction": "assessment.error_reduction:error_reduction",
    "attainable": "solving.attained:attained",
}
"""Functions, and classes when they are made, whose time is told apart."""


def problem(text: str, order: int = 1) -> ContactProblem:
    """``NAME:SIZE`` or a file, without move limits and without its exact solution."""
    name, _, size = text.partition(":")
    if name in EXAMPLES:
        given = EXAMPLES[name](int(size) if name == "6.1" else (2 * int(size), int(size)))
    elif name in CASES or name in MORE:
        given = {**CASES, **MORE}[name].problem(int(size))
    else:
        given = load_problem(Path(text).resolve())
    motion = replace(given.motion, delta=None)
    return replace(given, motion=motion, exact=None, reference=None, order=order)


def units(text: str, order: int = 1) -> list[float]:
    """Processor times of contact solves from nothing."""
    given, seconds = problem(text, order), []
    solver = ContactSolver(given)
    while len(seconds) < 5 or (sum(seconds) < 0.2 and len(seconds) < 50):
        seconds.append(timed(solver.solve, np.asarray(given.mesh.p))[1])
    return seconds


@contextmanager
def parts() -> Iterator[dict[str, float]]:
    """Exclusive processor time of each part in this context; what is left is ``rest``."""
    seconds, running, since = defaultdict(float), ["rest"], [time.process_time()]

    def switch() -> None:
        now = time.process_time()
        seconds[running[-1]] += now - since[0]
        since[0] = now

    def measured(part: str, inner: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            switch()
            running.append(part)
            try:
                return inner(*arguments, **named)
            finally:
                switch()
                running.pop()

        return call

    with ExitStack() as stack:
        for part, names in PARTS.items():
            for path, last in (name.split(":") for name in names.split()):
                module = path if path.startswith("formulations") else f"rmesh_nlp.{path}"
                inner = getattr(import_module(module), last)
                modules = [m for n, m in sys.modules.items() if n.startswith(("rmesh_nlp", "formulations"))]
                owners = [(m, key) for m in modules for key, value in vars(m).items() if value is inner]
                for owner, key in [(inner, "__init__")] if isinstance(inner, type) else owners:
                    stack.enter_context(patch.object(owner, key, measured(part, getattr(owner, key))))
        yield seconds
        switch()


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
        given, measured = problem(text, options.order), units(text, options.order)
        with parts() as seconds:
            solution = rm.solve(given, remesh=options.remesh)
        unit = statistics.median(measured + units(text, options.order))
        line = {"problem": text, "nodes": given.mesh.p.shape[1], "unit, ms": 1e3 * unit}
        line |= {"factorisations": solution.work.contact_factorisations}
        line |= {"energy": f"{solution.energy_audited:.8g}", "whole": sum(seconds.values()) / unit}
        lines.append(line | {part: seconds[part] / unit for part in (*PARTS, "rest")})
    print(markdown(pd.DataFrame(lines)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
