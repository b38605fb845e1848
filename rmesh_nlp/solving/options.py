"""A solve by names and plain values, as files and the command line state it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.formulation import Chooser, Formulation, composed, find, wrappers
from rmesh_nlp.solving.limits import Limits
from rmesh_nlp.solving.monitor import OnStep
from rmesh_nlp.solving.solution import Solution

ASKED = ("objective", "start", "seed", "tolerance")
"""Options of every solve that relocates, ..."""

LIMITS = {"time_limit_s": "seconds", "max_iterations": "iterations"}
"""... and its limits, by the fields of :class:`rmesh_nlp.solving.limits.Limits`."""


def solve_by_options(
    problem: ContactProblem,
    formulation: str | Formulation | Chooser,
    options: Mapping[str, Any],
    *,
    on_step: OnStep | None = None,
    certify: bool = False,
    safely: bool = True,
) -> Solution:
    """Solve with options by name: ``ASKED``, ``LIMITS``, fields of the formulation, and of what takes one.

    A formulation that is given as an object has its settings already, and takes the first two only.

    Raises
    ------
    BadInputError
        If the formulation does not take an option.
    """
    rest = {key: value for key, value in options.items() if value is not None}
    if rest.get("starts") and (rest.get("levels") or "seed" in rest):
        raise BadInputError("starts cannot be combined with levels or a seed")
    limits = Limits(**{name: rest.pop(key) for key, name in LIMITS.items() if key in rest})
    asked = {key: rest.pop(key) for key in ASKED if key in rest}
    known = _known(formulation)
    for key, value in rest.items():
        if key not in known and value not in (0, False):
            name = formulation if isinstance(formulation, str) else formulation.name
            said = f"the formulation {name!r} takes no {key}, got {key}={value!r}"
            raise BadInputError(f"{said}; it takes {', '.join(sorted(known))}")
    made = composed(formulation, rest) if isinstance(formulation, str) else formulation
    return solve(problem, made, limits=limits, on_step=on_step, certify=certify, safely=safely, **asked)


def accepted(formulation: str | Formulation | Chooser, names: Collection[str]) -> set[str]:
    """Those of the options that a formulation takes and heeds.

    Raises
    ------
    BadInputError
        If there is no such formulation.
    """
    return set(names) & _known(formulation)


def _known(formulation: str | Formulation | Chooser) -> set[str]:
    kind, known = type(formulation), {"objective", "on_step"}
    if isinstance(formulation, str):
        kind = find(formulation)
        known |= {"settings", *(field.name for field in fields(kind))}
    if not (issubclass(kind, Formulation) and not kind.relocates):
        known |= {*ASKED, *LIMITS}
        known |= {*wrappers()} if isinstance(formulation, str) else set()
    return known
