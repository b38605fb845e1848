"""What a solve is asked for: where it starts, and options by name as files and the command line have them."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.solving.clock import Limits
from rmesh_nlp.solving.formulation import Chooser, Formulation, available, composed, find, wrappers
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.solution import Solution

Start = str | Array | Solution | None
"""Node positions (2, nodes), "given", the name of a formulation, a Solution; None for the usual start."""

GIVEN = "given"


@dataclass(frozen=True)
class Beginning:
    """Admissible outer variables ``q`` of an outer problem, told whether it is close to a minimiser.

    The ``name`` for the record is "given", "random", "positions", that of a formulation, or "solution of" it.
    """

    outer: Outer
    q: Array
    name: str


def beginning(outer: Outer, start: Start, seed: int | None, monitor: Monitor) -> Beginning:
    """The outer variables to start from.

    None is the mesh as given, or with a seed random outer variables. The name of a formulation runs it first,
    from where ``seed`` says; its time and contact solves count.
    """
    if start is None and seed is not None:
        return Beginning(outer, outer.variables(seed=seed), "random")
    if start is None or (isinstance(start, str) and start == GIVEN):
        return Beginning(outer, outer.variables(), GIVEN)
    if isinstance(start, str):
        if start not in available():
            raise unknown("start", start, [GIVEN, *sorted(available())])
        first = composed(start, {})
        if not isinstance(first, Formulation):
            raise BadInputError(f"start must be a formulation that is no choice of others, got {start!r}")
        first.accepts(outer.problem, outer.objective)
        found = monitor.run(first, outer, outer.variables(seed=seed))
        return Beginning(outer.near(), found.q, start)
    if isinstance(start, Solution):
        q = outer.variables(positions(outer, start.mesh.p), design=start.design)
        return Beginning(outer.near(), q, f"solution of {start.formulation}")
    return Beginning(outer, outer.variables(positions(outer, start)), "positions")


def positions(outer: Outer, nodes: Any) -> Array:
    """Node positions as an array, checked to be those of the problem's mesh."""
    found, wanted = np.asarray(nodes, dtype=float), outer.problem.mesh.p.shape
    if found.ndim != 2 or found.shape[0] != 2:
        raise BadInputError(f"start must hold positions (2, nodes), got an array of shape {found.shape}")
    if found.shape != wanted:
        raise BadInputError(f"the start has {found.shape[1]} nodes, the problem {wanted[1]}")
    if (lost := np.argwhere(~np.isfinite(found))).size:
        raise BadInputError(f"start: node {int(lost[0][1])} has no finite position")
    return found


ASKED = ("objective", "start", "seed", "tolerance")
"""Options of every solve that relocates, ..."""

LIMITS = {"time_limit_s": "seconds", "max_iterations": "iterations"}
"""... and its limits, by the fields of :class:`rmesh_nlp.solving.clock.Limits`."""


def request(formulation: str | Formulation | Chooser, options: Mapping[str, Any]) -> dict[str, Any]:
    """Keywords of :func:`rmesh_nlp.solving.driver.solve` from options by name; None stands for the default.

    Options are ``ASKED``, ``LIMITS``, and, of a formulation by name, its fields and those of what takes one.
    A BadInputError names an option that the formulation does not take.
    """
    rest = {key: value for key, value in options.items() if value is not None}
    if rest.get("starts") and "seed" in rest:
        raise BadInputError("starts cannot be combined with a seed")
    if rest.get("remesh"):
        for other in ("starts", "seed", "start"):
            if other in rest and not (rest[other] == 0 and other != "seed"):
                raise BadInputError(
                    f"remesh cannot be combined with {other}, which belongs to the given mesh"
                )
    limits = Limits(**{name: rest.pop(key) for key, name in LIMITS.items() if key in rest})
    asked = {key: rest.pop(key) for key in ASKED if key in rest}
    known = _known(formulation)
    for key, value in rest.items():
        if key not in known and value not in (0, False):
            name = formulation if isinstance(formulation, str) else formulation.name
            said = f"the formulation {name!r} takes no {key}, got {key}={value!r}"
            raise BadInputError(f"{said}; it takes {', '.join(sorted(known))}")
    made = composed(formulation, rest) if isinstance(formulation, str) else formulation
    return {**asked, "formulation": made, "limits": limits}


def with_settings(
    formulation: str | Formulation | Chooser,
    settings: Mapping[str, Any],
    limits: Limits | None,
    asked: Mapping[str, Any],
) -> dict[str, Any]:
    """Keywords of a solve of a named formulation with settings, which may hold the limits of 0.1."""
    if not isinstance(formulation, str):
        example = f"{type(formulation).__name__}({next(iter(settings))}=...)"
        raise TypeError(f"settings are fields of the formulation: {example}")
    for old in LIMITS:
        if old in settings:
            warnings.warn(f"{old} is now a part of limits=Limits(...)", DeprecationWarning, stacklevel=3)
    given = {} if limits is None else {key: getattr(limits, name) for key, name in LIMITS.items()}
    return request(formulation, {**given, **settings, **asked})


def accepted(formulation: str | Formulation | Chooser, names: Collection[str]) -> set[str]:
    """Those of the options that a formulation takes."""
    return set(names) & _known(formulation)


def _known(formulation: str | Formulation | Chooser) -> set[str]:
    named = isinstance(formulation, str)
    kind = find(formulation) if isinstance(formulation, str) else type(formulation)
    known = {"objective", "on_step"}
    if named:
        known |= {"settings", *(field.name for field in fields(kind))}
    if getattr(kind, "relocates", True):
        known |= {*ASKED, *LIMITS, *(wrappers() if named else ())}
    return known
