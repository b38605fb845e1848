"""Solutions that several tests look at, each solved once: they are frozen, nobody changes their arrays."""

from dataclasses import replace
from functools import cache
from typing import Any
from unittest.mock import patch

import rmesh_nlp as rm
from rmesh_nlp.solving import driver


def solve_once(problem: rm.ContactProblem, *args: Any, **options: Any) -> rm.Solution:
    """``rm.solve`` without the second solve that follows an exploited end."""
    with patch.object(driver, "is_spurious", lambda _: False):
        return driver.solve(problem, *args, **options)


Size = int | tuple[int, int] | None


@cache
def example(name: str, size: Size = None, quadrature: int | None = None) -> rm.ContactProblem:
    """One of the paper's examples, by default at the paper's size and with its rule."""
    problem = rm.EXAMPLES[name]() if size is None else rm.EXAMPLES[name](size)
    return problem if quadrature is None else replace(problem, quadrature=quadrature)


@cache
def solved(
    formulation: str, name: str, size: Size = None, quadrature: int | None = None, objective: str = "energy"
) -> rm.Solution:
    """The solution of :func:`example` by a formulation with its defaults, from the mesh as given."""
    return solve_once(example(name, size, quadrature), formulation, objective=objective)
