"""Solutions that several tests look at, each solved once: they are frozen, nobody changes their arrays."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any
from unittest.mock import patch

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.solution import Solution


def solve_once(problem: ContactProblem, *args: Any, **options: Any) -> Solution:
    """``rm.solve`` without the second solve that follows an exploited end."""
    with patch.object(driver, "is_spurious", lambda _: False):
        return driver.solve(problem, *args, **options)


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
    return solve_once(example(name, size, quadrature), formulation, objective=objective)
