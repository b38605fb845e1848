"""Where a strategy starts: one resolver for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.solving.referee import Referee
from rmesh_nlp.solving.registry import accepted, available, find
from rmesh_nlp.solving.solution import Solution

Start = str | Array | Solution | None
"""Node positions (2, nodes), "given", the name of a strategy, a Solution; None for the usual start."""

GIVEN = "given"


@dataclass(frozen=True)
class Beginning:
    """A resolved start.

    Attributes
    ----------
    q : (n_q,) array
        Admissible moves.
    name : str
        For the record: "given", "random", "positions", the name of a strategy, or "solution of" it.
    solution : Solution or None
        What was found there before, if the start is a solution of this very problem: its
        displacement and forces start programs in more than the moves.
    contact_solves, iterations : int
        What finding the start has cost.
    """

    q: Array
    name: str
    solution: Solution | None = None
    contact_solves: int = 0
    iterations: int = 0


def beginning(
    referee: Referee,
    start: Start = None,
    seed: int | None = None,
    known: tuple[str, ...] = (),
    **options: Any,
) -> Beginning:
    """Resolve the keywords ``start`` and ``seed`` of a strategy.

    Parameters
    ----------
    referee : Referee
    start : see :data:`Start`
        None is the mesh as given, or with a seed random moves. The name of a strategy solves the
        problem by it first, from where ``seed`` says; its time and contact solves count.
    seed : int, optional
    known : tuple of str
        Further names that the strategy resolves itself, for the message.
    options
        Keywords for that strategy, as far as it takes them, such as ``time_limit_s``.

    Raises
    ------
    BadInputError
        If there is no such strategy, it found no valid mesh, or positions are not (2, nodes) numbers.
    """
    if start is None:
        return Beginning(referee.start(seed), GIVEN if seed is None else "random")
    if isinstance(start, str):
        if start == GIVEN:
            return Beginning(referee.start(None), GIVEN)
        if start not in available():
            raise unknown("start", start, [GIVEN, *sorted(available()), *known])
        first = find(start)
        keywords = {**options, "seed": seed}
        taken = {name: keywords[name] for name in accepted(first, keywords)}
        solution: Solution = first(referee.problem, **taken)
        return _from_solution(referee, solution, start, solution.contact_solves, solution.iterations)
    if isinstance(start, Solution):
        return _from_solution(referee, start, f"solution of {start.formulation}", 0, 0)
    return Beginning(referee.start(None, positions(referee, start)), "positions")


def _from_solution(
    referee: Referee, solution: Solution, name: str, contact_solves: int, iterations: int
) -> Beginning:
    q = referee.start(None, positions(referee, solution.mesh.p))
    return Beginning(q, name, solution, contact_solves, iterations)


def positions(referee: Referee, nodes: Any) -> Array:
    """Node positions as an array, checked to be those of the problem's mesh."""
    found, wanted = np.asarray(nodes, dtype=float), referee.problem.mesh.p.shape
    if found.ndim != 2 or found.shape[0] != 2:
        raise BadInputError(f"start must hold positions (2, nodes), got an array of shape {found.shape}")
    if found.shape != wanted:
        raise BadInputError(f"the start has {found.shape[1]} nodes, the problem {wanted[1]}")
    if not np.all(np.isfinite(found)):
        raise BadInputError(
            f"start: node {int(np.argwhere(~np.isfinite(found))[0][1])} has no finite position"
        )
    return found
