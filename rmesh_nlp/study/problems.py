"""Contact problems from what a plan says of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.examples.reference import with_reference
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.study.cases import build_problem
from rmesh_nlp.study.plan import PlannedSolve


def build(solve: PlannedSolve) -> ContactProblem:
    """The problem of a planned solve, with a reference solution if its objective needs one.

    Raises
    ------
    ValueError
        If it cannot be built here, say because its file is not on this machine.
    """
    problem = _problem(solve.problem)
    objective = solve.options.get("objective", "energy")
    if parse_objective(objective).needs_exact and solve.problem["kind"] == "example":
        return with_reference(problem)
    return problem  # where nothing is known of the solution the formulation refuses such an objective


def _problem(stated: dict[str, Any]) -> ContactProblem:
    if stated["kind"] == "example":
        size = stated.get("n")
        return build_problem(
            stated["example"],
            n=tuple(size) if isinstance(size, list) else size,
            delta=tuple(stated["delta"]) if isinstance(stated.get("delta"), list) else stated.get("delta"),
            quadrature=stated.get("quadrature", "midpoint"),
        )
    if stated["kind"] == "file":
        return load_problem(stated["path"])
    if stated["kind"] == "random":
        problem = random_problem(stated["seed"], kind=stated["of"])
        return replace(problem, name=f"random-{stated['seed']}", size=f"{problem.mesh.t.shape[1]} triangles")
    raise ValueError(f"unknown kind of problem {stated['kind']!r}")
