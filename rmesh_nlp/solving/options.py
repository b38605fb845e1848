"""A solve by names and plain values, as files and the command line state it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.formulation import Formulation, composed, find, wrappers
from rmesh_nlp.solving.limits import Limits
from rmesh_nlp.solving.monitor import OnStep
from rmesh_nlp.solving.solution import Solution

ASKED = ("objective", "start", "seed", "tolerance")
"""Options of every solve that relocates, ..."""

LIMITS = {"time_limit_s": "seconds", "max_iterations": "iterations"}
"""... and its limits, by the fields of :class:`rmesh_nlp.solving.limits.Limits`."""


def solve_by_options(
    problem: ContactProblem,
    formulation: str,
    options: Mapping[str, Any],
    *,
    on_step: OnStep | None = None,
    certify: bool = False,
    safely: bool = True,
) -> Solution:
    """Solve with options by name: ``ASKED``, ``LIMITS``, fields of the formulation, and of what takes one.

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
    made = composed(formulation, rest)
    return solve(problem, made, limits=limits, on_step=on_step, certify=certify, safely=safely, **asked)


def accepted(formulation: str, names: Collection[str]) -> set[str]:
    """Those of the options that a formulation takes and heeds.

    Raises
    ------
    BadInputError
        If there is no such formulation.
    """
    kind = find(formulation)
    known = {field.name for field in fields(kind)} | {"settings", "objective", "on_step"}
    if not (issubclass(kind, Formulation) and not kind.relocates):
        known |= {*ASKED, *LIMITS, *wrappers()}
    return set(names) & known
