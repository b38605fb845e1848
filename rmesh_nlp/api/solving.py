"""Any installed strategy by its name."""

from __future__ import annotations

import inspect
from typing import Any

from rmesh_nlp.campaign.strategies import available, load
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.solution import Solution


def strategies() -> tuple[str, ...]:
    """Names of the installed strategies, those of other packages included."""
    return tuple(sorted(available()))


def solve(problem: ContactProblem, strategy: str = "auto", **options: Any) -> Solution:
    """Relocate the nodes of a problem and solve the contact problem there.

    Parameters
    ----------
    problem : ContactProblem
    strategy : str
        ``auto`` chooses for the problem and says so in the record. ``fixed`` moves no node, ``nested``
        solves a contact problem per step, ``joint`` and ``mpcc`` find positions and displacement
        at once. See :func:`strategies`.
    options
        Keywords of the strategy, such as ``seed``, ``start`` or ``on_step``. Every strategy that
        takes a seed and a start also takes ``starts=n``, the best of n random starts, and
        ``levels=n``, on n uniform refinements.

    Returns
    -------
    Solution
        Judged by residuals that are measured on the problem; see ``status`` and ``success``.

    Raises
    ------
    ValueError
        If there is no such strategy, or it does not take this problem or option.
    """
    chosen = load(strategy)
    parameters = inspect.signature(chosen).parameters.values()
    known = [one.name for one in parameters if one.kind is one.KEYWORD_ONLY]
    unknown = () if any(one.kind is one.VAR_KEYWORD for one in parameters) else set(options) - set(known)
    if unknown:
        name = min(unknown)
        said = f"the formulation {strategy!r} takes no {name}, got {name}={options[name]!r}"
        raise BadInputError(f"{said}; it takes {', '.join(known)}")
    solution: Solution = chosen(problem, **options)
    return solution
