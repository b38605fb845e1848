"""Installed strategies by name, found through an entry-point group.

A package offers a strategy by one line in its ``pyproject.toml``::

    [project.entry-points."rmesh_nlp.formulations"]
    mine = "my_package.my_module:solve"

where ``solve(problem, ...)`` returns a :class:`rmesh_nlp.solving.solution.Solution`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from rmesh_nlp.errors import BadInputError, unknown

GROUP = "rmesh_nlp.formulations"

Solve = Callable[..., Any]
"""``solve(problem, *, settings, tolerance, max_iterations, time_limit_s, start, seed, on_step, ...)``;
a strategy may take fewer keywords, and more of its own."""

F = TypeVar("F", bound=Solve)


def available() -> dict[str, EntryPoint]:
    """Installed strategies by name; nothing is imported yet."""
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def find(name: str) -> Solve:
    """The ``solve`` of a strategy.

    Raises
    ------
    BadInputError
        If no strategy has this name, or it cannot be imported.
    """
    found = available()
    if name not in found:
        raise unknown("formulation", name, found)
    try:
        solve: Solve = found[name].load()
    except (ImportError, AttributeError) as error:
        raise BadInputError(
            f"formulation {name!r} cannot be loaded from {found[name].value}: {error}"
        ) from error
    return solve


def ignoring(*names: str) -> Callable[[F], F]:
    """Mark keywords that a strategy takes, so that all are called alike, but that change nothing in it."""

    def mark(solve: F) -> F:
        solve.ignored = frozenset(names)  # type: ignore[attr-defined]
        return solve

    return mark


def accepted(solve: Solve, names: Collection[str]) -> set[str]:
    """Those of the keyword ``names`` that ``solve`` takes and heeds."""
    parameters = inspect.signature(solve).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return set(names)
    return (set(names) & set(parameters)) - getattr(solve, "ignored", frozenset())
