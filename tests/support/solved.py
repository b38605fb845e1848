"""Solutions that several tests look at, each solved once: they are frozen, nobody changes their arrays."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.solution import Solution

Size = int | tuple[int, int] | None


@cache
def example(name: str, size: Size = None, quadrature: int | None = None) -> ContactProblem:
    """One of the paper's examples, by default at the paper's size and with its rule."""
    problem = EXAMPLES[name]() if size is None else EXAMPLES[name](size)
    return problem if quadrature is None else replace(problem, quadrature=quadrature)


@cache
def solved(
    formulation: str, name: str, size: Size = None, quadrature: int | None = None, objective: str = "energy"
) -> Solution:
    """The solution of :func:`example` by a formulation with its defaults, from the mesh as given."""
    return solve(example(name, size, quadrature), formulation, objective=objective, safely=False)
