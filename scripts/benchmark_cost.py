"""What a whole solve costs, in contact solves of its mesh, and where that goes.

    python scripts/benchmark_cost.py                              Example 6.1 without move limits
    python scripts/benchmark_cost.py 6.3:12 a.toml --unit OLD    the unit by the contact solver of a checkout
    python scripts/benchmark_cost.py 6.1:8 wedge:12 --order 2    also problems of the benchmarks of meshes

Processor time of one thread. The unit is a contact solve of the mesh as given from nothing, assembly
included, measured before and after each solve. Libraries are loaded before. The columns are exclusive.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import numpy as np

SCRIPTS = Path(__file__).resolve().parent
sys.path[:0] = [str(path) for path in (SCRIPTS, SCRIPTS / "gallery") if str(path) not in sys.path]

import rmesh_nlp as rm  # noqa: E402
from best_mesh.cases import CASES, MORE  # noqa: E402
from rmesh_nlp.contact.solver import ContactSolver  # noqa: E402
from rmesh_nlp.examples import EXAMPLES  # noqa: E402
from rmesh_nlp.io.problem_file import load_problem  # noqa: E402
from rmesh_nlp.problem import ContactProblem  # noqa: E402

PARTS = {
    "models": "contact.solver:ContactSolver models.reduced_model:ReducedEnergy "
    "models.second_derivatives:Curvature",
    "coarser": "models.levels:hierarchy models.levels:prolonged models.levels:lowers",
    "descents": "models.regularised_descent:descend models.regularised_descent:to_stationary",
    "metric": "models.remeshing:metric_start",
    "estimate": "models.regularisation:gain_estimate",
    "unit": "optimize.budget:timed",
    "assess": "formulations.confirmed:agrees solving.assess:assess",
    "reduction": "assessment.error_reduction:error_reduction",
    "attainable": "solving.attained:attained",
}
"""Functions, and classes when they are made, whose time is told apart."""


def problem(text: str, order: int = 1) -> ContactProblem:
    """``NAME:SIZE`` or a file, without move limits and without its exact solution."""
    name, _, size = text.partition(":")
    if name in EXAMPLES:
        found = EXAMPLES[name](int(size) if name == "6.1" else (2 * int(size), int(size)))
    elif name in CASES or name in MORE:
        found = {**CASES, **MORE}[name].problem(int(size))
    else:
        found = load_problem(Path(text).resolve())
    motion = replace(found.motion, delta=None)
    return replace(found, motion=motion, exact=None, reference=None, order=order)


def units(text: str, order: int = 1) -> list[float]:
    """Processor times of contact solves from nothing."""
    given, found = problem(text, order), []
    solver = ContactSolver(given)
    while len(found) < 5 or (sum(found) < 0.2 and len(found) < 50):
        began = time.process_time()
        solver.solve(np.asarray(given.mesh.p))
        found.append(time.process_time() - began)
    return found


def units_of(checkout: str, text: str, order: int) -> list[float]:
    """The same by another version of the package."""
    code = f"import benchmark_cost; print(*benchmark_cost.units({text!r}, {order}))"
    path = os.pathsep.join((checkout, str(Path(__file__).parent)))
    command, environment = [sys.executable, "-c", code], {**os.environ, "PYTHONPATH": path}
    found = subprocess.check_output(command, env=environment, cwd=checkout)
    return [float(seconds) for seconds in found.split()]


@contextmanager
def parts() -> Iterator[dict[str, float]]:
    """Exclusive processor time of each part in this context; what is left is ``rest``."""
    seconds, running, since, replaced = defaultdict(float), ["rest"], [time.process_time()], []

    def switch() -> None:
        now = time.process_time()
        seconds[running[-1]] += now - since[0]
        since[0] = now

    def timed(part: str, inner: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            switch()
            running.append(part)
            try:
                return inner(*arguments, **named)
            finally:
                switch()
                running.pop()

        return call

    for part, names in PARTS.items():
        for path, last in (name.split(":") for name in names.split()):
            module = path if path.startswith("formulations") else f"rmesh_nlp.{path}"
            inner = getattr(import_module(module), last)
            known = [m for n, m in sys.modules.items() if n.startswith(("rmesh_nlp", "formulations"))]
            owners = [(m, key) for m in known for key, one in vars(m).items() if one is inner]
            for owner, key in [(inner, "__init__")] if isinstance(inner, type) else owners:
                replaced.append((owner, key, getattr(owner, key)))
                setattr(owner, key, timed(part, getattr(owner, key)))
    try:
        yield seconds
    finally:
        switch()
        for owner, key, inner in replaced:
            setattr(owner, key, inner)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problems", nargs="*", default=["6.1:8", "6.1:16", "6.1:32", "6.1:64"])
    parser.add_argument("--unit", metavar="CHECKOUT", help="whose contact solver is the unit; default: this")
    parser.add_argument("--order", type=int, choices=(1, 2), default=1, help="of displacements")
    parser.add_argument("--remesh", action="store_true", help="begin on a mesh for the solution")
    options = parser.parse_args(arguments)
    unit_of = units if options.unit is None else partial(units_of, options.unit)
    rm.solve(problem("6.1:8", options.order), remesh=options.remesh)
    columns = ["problem", "nodes", "unit, ms", "factorisations", "energy", "whole", *PARTS, "rest"]
    print(f"| {' | '.join(columns)} |\n|---{'|--:' * (len(columns) - 1)}|")
    for text in options.problems:
        measured, given = unit_of(text, options.order), problem(text, options.order)
        with parts() as seconds:
            solution = rm.solve(given, remesh=options.remesh)
        unit = statistics.median(measured + unit_of(text, options.order))
        row: list[Any] = [text, given.mesh.p.shape[1], f"{1e3 * unit:.3g}"]
        row += [solution.work.contact_factorisations, f"{solution.energy_audited:.8g}"]
        cost = [sum(seconds.values()), *(seconds[part] for part in (*PARTS, "rest"))]
        print(f"| {' | '.join(map(str, row))} | {' | '.join(f'{one / unit:.3g}' for one in cost)} |")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
