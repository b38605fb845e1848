"""An exploited end is not the last word: the solve goes on once with a safe discretisation.

Where an optimiser has lived on an error of the discretisation, so that the continuous energy rose or most of
the gain is none, the problem is solved again with a rule for the loads of high degree and with gaps that hold
along edges. The end of lower continuous energy is the solution. If that is an exploited one as well, as much
of the way to its mesh is taken as lowers the continuous energy most.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.verdict import ROUNDING
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.referee import Referee
from rmesh_nlp.solving.registry import accepted
from rmesh_nlp.solving.solution import Solution, counted
from rmesh_nlp.solving.surviving import with_surviving_gain

SAFE_DEGREE = 20
"""Degree of the rule of the second solve."""

SURVIVES = 0.5
"""Least part of a gain by a formulation's own measure that must be one of the continuous energy."""

PARTS = tuple(0.5**k for k in range(1, 7))
"""Parts of the way to an exploited mesh that are tried."""


def safely(solve: Callable[..., Solution]) -> Callable[..., Solution]:
    """A strategy that goes on with the safe discretisation where its end is an exploited one."""

    @functools.wraps(solve)
    def run(problem: ContactProblem, **options: Any) -> Solution:
        began = time.perf_counter()
        first = solve(problem, **options)
        outer = options.get("objective", "energy")
        if not _is_hollow(first):
            return with_surviving_gain(first, outer)
        found, safe = first, safe_discretisation(first.problem)
        said = f"{first.measured.costliest} was exploited" if first.measured else ""
        if safe is not first.problem:
            limits = {}
            if "time_limit_s" in accepted(solve, ("time_limit_s",)) and "time_limit_s" in options:
                left = options["time_limit_s"] - (time.perf_counter() - began)
                limits["time_limit_s"] = max(left, 1e-3)
            found = _better(first, solve(safe, **{**options, **limits}))
            said += f", solved again with a rule of degree {SAFE_DEGREE} and gaps along edges"
        if found.status is Status.EXPLOITED:
            found, part = damped(found)
            said += f", and {part:g} of the way to the last mesh taken" if part < 1 else ""
        return with_surviving_gain(replace(found, extra={**found.extra, "safe": said}), outer)

    return run


def _is_hollow(solution: Solution) -> bool:
    """Whether the energy rose, or most of the gain is an error of the discretisation."""
    if solution.status is Status.EXPLOITED:
        return True
    measured = solution.measured
    if not solution.success or measured is None or not measured.is_energy:
        return False
    rounding = ROUNDING * measured.size
    return measured.gain > rounding and measured.gain_audited < SURVIVES * measured.gain - rounding


def _better(first: Solution, second: Solution) -> Solution:
    """Of two solutions the successful one of lower continuous energy, with the costs of both."""
    worse = second.audit.energy_audited > first.audit.energy_audited
    if first.success and (not second.success or worse) and second.status is not Status.INTERRUPTED:
        return _together(second, first)
    return _together(first, second)


def safe_discretisation(problem: ContactProblem) -> ContactProblem:
    """The problem with accurate loads and gaps along edges; as it is if it has both."""
    safe = with_edge_gaps(problem)
    rule = safe.rule
    return safe if isinstance(rule, int) and rule >= SAFE_DEGREE else safe.with_rule(SAFE_DEGREE)


def damped(solution: Solution) -> tuple[Solution, float]:
    """The part of the way from the given mesh to the last one that lowers the continuous energy most.

    Returns the solution there, or the same one with part 1 if no part lowers it.
    """
    problem, given = solution.problem, solution.initial_nodes
    if solution.given is not None:
        return solution, 1.0
    way = np.asarray(solution.mesh.p) - given
    energies = {}
    for part in PARTS:
        there = admissible(problem, given + part * way)
        if there.status is Status.CONVERGED:
            energies[part] = there.energy
    best = min(energies, key=energies.__getitem__, default=1.0)
    if best == 1.0 or not energies[best] < solution.energy_initial_audited:
        return solution, 1.0
    referee = Referee(problem, solution.objective)
    q = referee.start(None, given + best * way)
    found = referee.judge(
        solution.formulation,
        q,
        status=Status.STALLED,
        history=list(solution.history),
        iterations=solution.iterations,
        contact_solves=solution.contact_solves,
        objective=solution.objective,
        start=solution.start,
        settings=solution.settings,
        seed=solution.seed,
        extra=solution.extra,
        tolerance=solution.extra["tolerance"],
    )
    return _together(solution, found, work=False), best


def _together(first: Solution, second: Solution, work: bool = True) -> Solution:
    """The second solution with the costs of both."""
    return replace(
        second,
        iterations=second.iterations + (first.iterations if work else 0),
        contact_solves=second.contact_solves + (first.contact_solves if work else 0),
        build_time_s=first.build_time_s + second.build_time_s,
        solve_time_s=first.solve_time_s + second.solve_time_s,
        audit_time_s=first.audit_time_s + second.audit_time_s,
        extra={**second.extra, **(counted((first, second)) if work else {})},
    )
