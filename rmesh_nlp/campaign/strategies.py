"""Strategies as a campaign runs them: by name, with the options ``starts`` and ``levels``."""

from __future__ import annotations

from rmesh_nlp.solving.registry import GROUP, Solve, accepted, available, find
from rmesh_nlp.solving.safely import safely
from rmesh_nlp.solving.starts import with_starts

__all__ = ["GROUP", "Solve", "accepted", "available", "load"]


def load(name: str) -> Solve:
    """The ``solve`` of a strategy, with the options ``starts`` and ``levels`` if it allows them.

    Raises
    ------
    BadInputError
        If no strategy has this name, or it cannot be imported.
    """
    return with_starts(safely(find(name)))
