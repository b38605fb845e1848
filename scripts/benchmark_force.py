"""What a contact force costs to a true error: by refinement to an accuracy, and by relocation.

    python scripts/benchmark_force.py my.toml docs/parts/bracket.toml

Each problem file is solved by `adaptive` to each of the accuracies, then by `auto` as the file stands, its
mesh refined uniformly until the error of the computed force on its first contact boundary is no larger than
the accuracy, or a solve has taken the limit of seconds. The time of `auto` is that of its last mesh alone.
The true force is the corrected one of order 2 on the mesh of `adaptive`, refined uniformly. Seconds are of
the processor, without the reference. Rows are kept in DIR/rows.jsonl: a run measures only what is missing
there. Writes DIR/table.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

import rmesh_nlp as rm
from rmesh_nlp.certificate.estimates import OnMesh, estimates, of_contact
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rows import Row, Store, command_line, markdown, timed

ACCURACIES = (0.005, 0.002)
"""What is asked for."""

LIMIT = 600.0
"""Seconds by the clock that `auto` may take on a mesh; a busy machine needs many times the processor's."""


def true_force(problem: ContactProblem, text: str) -> float:
    """The corrected force of order 2 on the mesh refined once."""
    fine = refined(replace(problem, order=2, motion=replace(problem.motion, delta=None)))
    return estimates(OnMesh.of(ContactSolver(fine)), (text,))[0].value


def measured(problem: ContactProblem, accuracy: float) -> Iterator[Row]:
    """The row of one problem; errors are those of the computed and of the best known force, in per cent."""
    text = of_contact(problem, "resultant")[0]
    solution, spent = timed(rm.solve, problem, accuracy=accuracy, quantities=(text,))
    true, known = true_force(solution.problem, text), solution.details["estimates"][text]
    coarse, error = problem, np.inf
    while error > 100 * accuracy:
        moved, seconds = timed(rm.solve, coarse, "auto", limits={"seconds": LIMIT})
        error = abs(moved.contact[text[10:-1]]["normal_force"] / true - 1) * 100
        coarse = refined(coarse)
        if not moved.success:
            break
    yield {
        "nodes": solution.mesh.p.shape[1],
        "error [%]": abs(known["computed"] / true - 1) * 100,
        "of the value [%]": abs(known["value"] / true - 1) * 100,
        "time [s]": spent,
        "auto: nodes": moved.mesh.p.shape[1],
        "auto: error [%]": error,
        "auto: status": moved.status.value,
        "auto: time [s]": seconds,
        "times": seconds / spent,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the table."""
    parser = command_line(__doc__, out="results/force")
    parser.add_argument("problems", nargs="+", metavar="FILE.toml")
    options = parser.parse_args(arguments)
    store = Store(options.out / "rows.jsonl")
    for path in options.problems:
        problem = load_problem(path)
        timed(rm.solve, problem, accuracy=0.5)  # imports and compilation
        for accuracy in ACCURACIES:
            key = {"problem": problem.name, "accuracy [%]": 100 * accuracy}
            store.measure(key, partial(measured, problem, accuracy))
    frame = pd.DataFrame(store.rows)
    (options.out / "table.md").write_text(markdown(frame) + "\n", encoding="utf-8")
    print(markdown(frame), f"median: {np.median(frame['times'].dropna()):.1f} times", sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
