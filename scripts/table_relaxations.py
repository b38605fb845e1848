"""Relaxations x objectives x examples by the all-at-once strategy: the table for a paper.

    python scripts/table_relaxations.py --out relaxations --n 8

Every row is one solve of ``formulations.mpcc`` from the initial grid; rows that do not succeed
are kept with their status. Errors of examples without an exact solution are measured against a
fine grid if ``--reference`` asks for it, else left out. Writes ``relaxations.csv`` and
``relaxations.md``, and prints the latter.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from support.formulations import joint, mpcc
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.reference import with_reference
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.history import TIME_LIMIT_S

OBJECTIVES = ("energy", "error-energy", "error-l2", "error-h1", "contact", "energy+0.1*quality")
COLUMNS = {
    "example": "example",
    "objective": "objective",
    "relaxation": "relaxation",
    "status": "status",
    "objective_initial": "initial",
    "objective_value": "final",
    "iterations": "iterations",
    "build_time_s": "build [s]",
    "solve_time_s": "solve [s]",
    "over_joint": "time over joint",
    "loss": "above joint [% of gain]",
    "stages": "t: iterations",
    "equilibrium_residual": "equilibrium",
    "complementarity_residual": "complementarity",
    "stationarity": "label",
    "b_stationary": "B",
    "biactive": "biactive",
}


def cost(record: dict[str, Any]) -> float:
    """Seconds of build and solve."""
    return float(record["build_time_s"] + record["solve_time_s"])


def row(
    problem: ContactProblem, objective: str, relaxation: str, time_limit_s: float = TIME_LIMIT_S
) -> dict[str, Any]:
    """One solve; a solve that raises is a row with its message as status.

    ``joint`` is solved anew beside each row: on a busy machine only neighbours can be compared.
    """
    try:
        record = mpcc.solve(
            problem, objective=objective, relaxation=relaxation, time_limit_s=time_limit_s
        ).record()
        reference = joint.solve(problem, time_limit_s=time_limit_s).record()
        record["over_joint"] = cost(record) / cost(reference)
        if objective == "energy":
            record["loss"] = 100 * (record["energy"] - reference["energy"]) / reference["gain"]
        stages = [f"{stage['t']:.0e}: {stage['iterations']}" for stage in record.get("stages", ())]
        record["stages"] = ", ".join(stages)
    except Exception as error:  # kept as a row: a table must not lose a combination
        record = {
            "example": problem.name,
            "objective": objective,
            "relaxation": relaxation,
            "status": str(error),
        }
    return {title: record.get(key) for key, title in COLUMNS.items()}


def main(arguments: list[str] | None = None) -> int:
    """Solve all combinations and write the table; 0 if every solve converged."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--examples", nargs="+", default=list(EXAMPLES), choices=list(EXAMPLES))
    parser.add_argument("--objectives", nargs="+", default=list(OBJECTIVES))
    parser.add_argument("--relaxations", nargs="+", default=list(RELAXATIONS), choices=list(RELAXATIONS))
    parser.add_argument("--n", type=int, help="columns of the grid (6.2, 6.3: half as many rows)")
    parser.add_argument("--degree", type=int, help="of the rule for loads; by default the paper's midpoints")
    parser.add_argument("--reference", action="store_true", help="errors of 6.2 and 6.3, slow")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, help="seconds of each solve")
    parser.add_argument("--out", type=Path, default=Path("relaxations"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in options.examples:
        size = None if options.n is None else options.n if name == "6.1" else (options.n, options.n // 2)
        problem = EXAMPLES[name]() if size is None else EXAMPLES[name](size)
        if options.degree is not None:
            problem = replace(problem, quadrature=options.degree)
        for objective in options.objectives:
            needs_exact = parse_objective(objective).needs_exact
            if needs_exact and problem.exact is None and not options.reference:
                continue
            if needs_exact:
                problem = with_reference(problem)
            for relaxation in options.relaxations:
                rows.append(row(problem, objective, relaxation, options.time_limit))
                print(f"{name} {objective} {relaxation}: {rows[-1]['status']}", file=sys.stderr)
                # written after every row, so that an interruption keeps what is done
                pd.DataFrame(rows).to_csv(options.out / "relaxations.csv", index=False)
    table = markdown(rows)
    (options.out / "relaxations.md").write_text(table + "\n", encoding="utf-8")
    print(table)
    return 0 if all(r["status"] == "converged" for r in rows) else 1


def markdown(rows: list[dict[str, Any]]) -> str:
    """The rows as a Markdown table."""

    def cell(title: str, value: Any) -> str:
        if value is None:
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, float):
            return f"{value:.6g}" if title in ("initial", "final") else f"{value:.2g}"
        return str(value)

    titles = list(COLUMNS.values())
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    lines += ["| " + " | ".join(cell(title, r[title]) for title in titles) + " |" for r in rows]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
