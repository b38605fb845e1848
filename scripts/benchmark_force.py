"""What a contact force costs to the same true error: by refinement to an accuracy, and by relocation.

    python scripts/benchmark_force.py my.toml docs/parts/bracket.toml

Each problem file is solved by `auto` as it stands. Then `adaptive` is asked for ever smaller accuracies,
until the error of the computed force on its first contact boundary is no larger than that of `auto`. The true
force is the corrected one of order 2 on the last of these meshes, refined uniformly twice: it has 16 times
the triangles. Seconds are of the processor, without the reference. Rows are kept in DIR/rows.jsonl: a run
measures only what is missing there. Writes DIR/table.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

import rmesh_nlp as rm
from rmesh_nlp.certificate.estimates import OnMesh, estimates, of_contact
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined
from rows import Row, Store, command_line, markdown, timed

ACCURACIES = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)
"""What is asked for, one after the other."""


def true_force(problem: ContactProblem, text: str) -> float:
    """The corrected force of order 2 on the mesh refined twice."""
    fine = refined(refined(replace(problem, order=2, motion=replace(problem.motion, delta=None))))
    return estimates(OnMesh.of(ContactSolver(fine)), (text,))[0].value


def measured(problem: ContactProblem) -> Iterator[Row]:
    """The row of one problem; errors are those of the computed and of the best known force, in per cent."""
    text = of_contact(problem, "resultant")[0]
    moved, seconds = timed(rm.solve, problem, "auto")
    computed = moved.contact[text[10:-1]]["normal_force"]
    known = moved.details.get("estimates", {}).get(text, {}).get("value", computed)
    asked = [timed(rm.solve, problem, accuracy=accuracy) for accuracy in ACCURACIES]
    true = true_force(asked[-1][0].problem, text)
    for accuracy, (solution, spent) in zip(ACCURACIES, asked, strict=True):
        force = solution.details["estimates"][text]
        errors = [
            abs(value / true - 1) * 100 for value in (computed, known, force["computed"], force["value"])
        ]
        if errors[2] <= errors[0] or accuracy == ACCURACIES[-1]:
            nodes = [one.mesh.p.shape[1] for one in (moved, solution)]
            yield {
                "auto: nodes": nodes[0],
                "error [%]": errors[0],
                "corrected [%]": errors[1],
                "time [s]": seconds,
                "asked for [%]": 100 * accuracy,
                "nodes": nodes[1],
                "its error [%]": errors[2],
                "its corrected [%]": errors[3],
                "its time [s]": spent,
                "times": seconds / spent,
            }
            return


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is missing, and write the table."""
    parser = command_line(__doc__, out="results/force")
    parser.add_argument("problems", nargs="+", metavar="FILE.toml")
    options = parser.parse_args(arguments)
    store = Store(options.out / "rows.jsonl")
    for path in options.problems:
        problem = load_problem(path)
        timed(rm.solve, problem, accuracy=0.5)  # imports and compilation
        store.measure({"problem": problem.name}, lambda problem=problem: measured(problem))
    frame = pd.DataFrame(store.rows)
    (options.out / "table.md").write_text(markdown(frame) + "\n", encoding="utf-8")
    print(markdown(frame), f"median: {np.median(frame['times'].dropna()):.1f} times", sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
