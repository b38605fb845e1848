"""Problem files in a comparison, and uniform refinements of their meshes beside them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.contact_problem import refined

SUFFIX = ".toml"

REFINEMENTS = 2
"""Uniform refinements that a problem is compared with, by default ..."""

LARGEST = 20_000
"""... as long as they have no more nodes than this."""


def own_problems(names: Collection[str]) -> list[ContactProblem]:
    """The problems of those names that are files.

    Raises
    ------
    BadInputError
        If a file cannot be used, or two problems have one name.
    """
    problems = [load_problem(Path(name)) for name in names if name.endswith(SUFFIX)]
    called = [problem.name for problem in problems]
    for name in called:
        if called.count(name) > 1:
            raise BadInputError(f"two problem files are both called {name!r}: give them a name of their own")
    return problems


def refinements(problem: ContactProblem, count: int | None = None) -> Iterator[ContactProblem]:
    """The problem on uniformly refined meshes, coarsest first.

    Parameters
    ----------
    count : int, optional
        How many; by default ``REFINEMENTS`` of at most ``LARGEST`` nodes.
    """
    for _ in range(REFINEMENTS if count is None else count):
        nodes = problem.mesh.p.shape[1] + problem.mesh.facets.shape[1]
        if count is None and nodes > LARGEST:
            return
        problem = refined(problem)
        yield problem
