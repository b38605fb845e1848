"""What a whole solve costs, in contact solves of its mesh, and where that goes.

    python scripts/benchmark_cost.py                       Example 6.1 without move limits, 8 to 64 squares
    python scripts/benchmark_cost.py 6.1:128 L-shape:1 6.2:6 my.toml

Processor time of one thread, in units of a contact solve of the mesh as given from nothing, assembly
included, measured before and after in the same process; a first solve of a small mesh loads the libraries.
Columns are exclusive: what a part spends in another one counts there.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
SCRIPTS = Path(__file__).resolve().parent
sys.path[:0] = [str(path) for path in (SCRIPTS, SCRIPTS / "gallery") if str(path) not in sys.path]

import numpy as np  # noqa: E402

import rmesh_nlp as rm  # noqa: E402
from best_mesh.cases import CASES  # noqa: E402
from formulations import auto, cascade, confirmed  # noqa: E402, F401
from rmesh_nlp.contact.solver import ContactSolver  # noqa: E402
from rmesh_nlp.examples import EXAMPLES  # noqa: E402
from rmesh_nlp.io.problem_file import load_problem  # noqa: E402
from rmesh_nlp.problem import ContactProblem  # noqa: E402
from rmesh_nlp.solving import driver  # noqa: E402, F401

PARTS = {
    "coarsen": ["models.levels.coarsened", "models.levels.prolonged"],
    "build": [
        "contact.solver.ContactSolver.__init__",
        "models.reduced_model.ReducedEnergy.__init__",
        "models.energy_nlp.relocation",
        "models.second_derivatives.Curvature.__init__",
    ],
    "coarse": ["models.cascade._Descents.searched"],
    "descend": ["models.regularised_descent.descend"],
    "finish": ["models.regularised_descent.finished"],
    "estimate": ["models.regularisation.gain_estimate"],
    "accept": ["models.levels.accepted"],
    "given": ["solving.clock.timed"],
    "confirm": ["formulations.confirmed.agrees"],
    "assess": ["solving.assess.assess"],
    "reduction": ["assessment.error_reduction.error_reduction"],
}
"""Functions whose time is told apart, below ``rmesh_nlp``."""


def problem(text: str) -> ContactProblem:
    """``NAME:SIZE`` or a file, without move limits and without its exact solution."""
    name, _, size = text.partition(":")
    if name in CASES:
        found = CASES[name].problem(int(size))
    else:
        found = EXAMPLES[name](n=(2 * int(size), int(size))) if name in EXAMPLES else load_problem(Path(text))
    motion = replace(found.motion, delta=None)
    return replace(found, motion=motion, quadrature="auto", exact=None, reference=None)


class Parts:
    """Exclusive processor time of the functions of ``PARTS``, which it wraps wherever they are known."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._open, self._since = ["rest"], time.process_time()
        for part, names in PARTS.items():
            for name in names:
                self._wrap(part, name if name.startswith("formulations") else f"rmesh_nlp.{name}")

    def enter(self, part: str | None) -> None:
        """A part begins, or (None) the last one ends."""
        now = time.process_time()
        self.seconds[self._open[-1]] += now - self._since
        self._since = now
        if part is None:
            self._open.pop()
        else:
            self._open.append(part)

    def _wrap(self, part: str, name: str) -> None:
        path, _, last = name.rpartition(".")
        owner: Any = sys.modules.get(path)
        if owner is None:  # a method
            module, _, cls = path.rpartition(".")
            owner = getattr(sys.modules[module], cls)
        inner: Callable[..., Any] = getattr(owner, last)

        @wraps(inner)
        def timed(*arguments: Any, **named: Any) -> Any:
            self.enter(part)
            try:
                return inner(*arguments, **named)
            finally:
                self.enter(None)

        setattr(owner, last, timed)
        for module in list(sys.modules.values()):
            if getattr(module, "__name__", "").startswith(("rmesh_nlp", "formulations")):
                for key in [key for key, value in vars(module).items() if value is inner]:
                    setattr(module, key, timed)


def unit(problem: ContactProblem, seconds: float = 0.3) -> list[float]:
    """Processor times of contact solves from nothing."""
    solver, found = ContactSolver(problem), []
    while (sum(found) < seconds and len(found) < 50) or len(found) < 3:
        began = time.process_time()
        solver.solve(np.asarray(problem.mesh.p))
        found.append(time.process_time() - began)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("problems", nargs="*", default=["6.1:8", "6.1:16", "6.1:32", "6.1:64"])
    parser.add_argument("--repeat", type=int, default=1, help="solves of each; the cheapest one counts")
    options = parser.parse_args(arguments)
    parts = Parts()
    rm.solve(problem("6.1:8"))
    columns = ["build", *(name for name in PARTS if name != "build"), "rest"]
    print("| problem | nodes | ms | factorisations | energy | whole |", " | ".join(columns), "|")
    print("|---|" + "--:|" * (5 + len(columns)))
    for text in options.problems:
        given, best, units = problem(text), None, []
        for _ in range(options.repeat):
            units += unit(given)
            parts.enter("rest")
            parts.seconds.clear()
            solution = rm.solve(given)
            parts.enter(None)
            found = dict(parts.seconds)
            if best is None or sum(found.values()) < sum(best.values()):
                best = found
            units += unit(given)
        one = statistics.median(units)
        cost = [sum(best.values()), *(best.get(name, 0.0) for name in columns)]
        known = f"{given.mesh.p.shape[1]} | {1e3 * one:.3g} | {solution.work.contact_factorisations}"
        figures = " | ".join(f"{value / one:.3g}" for value in cost)
        print(f"| {text} | {known} | {solution.audit.energy_audited:.8g} | {figures} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
