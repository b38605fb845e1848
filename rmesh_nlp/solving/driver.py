"""``solve``: the one driver of all formulations."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from rmesh_nlp.assessment.assessor import Quantities, worse
from rmesh_nlp.assessment.error_reduction import error_reduction
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.settings import check_positive
from rmesh_nlp.solving.assess import Assessment, assess
from rmesh_nlp.solving.certify import certified
from rmesh_nlp.solving.clock import TOLERANCE, Limits, timed
from rmesh_nlp.solving.exploited import (
    SAFE_DEGREE,
    back,
    better,
    damped,
    is_hollow,
    safe_discretisation,
    surviving_gain,
)
from rmesh_nlp.solving.formulation import Chooser, Formulation, Wrapper, composed
from rmesh_nlp.solving.monitor import Monitor, OnStep
from rmesh_nlp.solving.options import LIMITS, Start, beginning, request
from rmesh_nlp.solving.outer import Outer, Work
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.solving.solution import Solution


def solve(
    problem: ContactProblem,
    formulation: str | Formulation | Chooser = "auto",
    *,
    objective: str | Objective = "energy",
    start: Start = None,
    seed: int | None = None,
    tolerance: float = TOLERANCE,
    limits: Limits | None = None,
    on_step: OnStep | None = None,
    certify: bool = False,
    **settings: Any,
) -> Solution:
    """Relocate the nodes of a problem and solve the contact problem there.

    Parameters
    ----------
    problem : ContactProblem
    formulation : str or Formulation
        A name of :func:`rmesh_nlp.formulations`, or an object whose fields are its settings, such as
        ``Joint(first_barrier=1e-2)`` of ``formulations.joint``. ``auto`` chooses for the problem and the
        record has the reason; ``fixed`` moves no node, ``nested`` solves a contact problem per step,
        ``joint`` and ``mpcc`` find positions and displacement at once.
    objective : str or Objective
        What is minimised: "energy", another one such as "error-l2 + 0.01*quality" or "mean(top, -uy)", see
        :mod:`rmesh_nlp.fem.objective_text`, or an object of :mod:`rmesh_nlp.fem.quantities`.
    start : positions (2, nodes), "given", name of a formulation, or Solution, optional
        See :func:`rmesh_nlp.solving.options.beginning`.
    seed : int, optional
        Random start; by default the mesh as given.
    tolerance : float
        Largest measured first-order residual of a solution that is called converged.
    limits : Limits, optional
        After them, as after Ctrl-C, the best valid mesh so far is the solution.
    on_step : callable, optional
        Called with each step of the history.
    certify : bool
        Bound the error of the solution: ``solution.certificate``.
    settings
        Settings of a formulation that is named, and of what takes one, as on the command line:
        ``flips=True``, ``starts=8``. ``time_limit_s`` and ``max_iterations``, the limits of 0.1, still work
        and warn.

    Returns
    -------
    Solution
        Assessed by what is measured on the problem; see ``status`` and ``success``.

    Raises
    ------
    BadInputError
        If there is no such formulation, or it does not take the problem or an option.
    """
    if settings:
        return _by_settings(
            problem,
            formulation,
            settings,
            limits,
            on_step,
            certify,
            {"objective": objective, "start": start, "seed": seed, "tolerance": tolerance},
        )
    check_positive(tolerance=tolerance)
    monitor, outer_objective = Monitor(limits, on_step), parse_objective(objective)
    asked = composed(formulation, {}) if isinstance(formulation, str) else formulation
    is_started = start is not None or seed is not None
    chosen, stated, why = _chosen(asked, problem, outer_objective, is_started)
    chosen.accepts(stated, outer_objective)
    name = asked.name
    first, begin, found, spent = _once(chosen, stated, outer_objective, start, seed, tolerance, monitor)
    details: dict[str, Any] = {}
    if is_hollow(found):
        is_safe = safe_discretisation(found.outcome.outer.problem) is found.outcome.outer.problem
        said = f"{found.measured.costliest} was exploited" if found.measured else ""
        if monitor.stopped is None and not is_safe:
            safe = safe_discretisation(stated)  # as it was given: the end may be on a finer mesh
            other, _, second, spent = _once(chosen, safe, outer_objective, start, seed, tolerance, monitor)
            if better(found, second) is second:
                first, found = other, second
            said += f", solved again with a rule of degree {SAFE_DEGREE} and gaps along edges"
        if found.status is Status.EXPLOITED:
            with monitor.clock.during("audit"):
                found, part = monitor.to_its_end(lambda: damped(first, found))
            said += f", and {part:g} of the way to the last mesh taken" if part < 1 else ""
        details["safe"] = said
    if monitor.stopped is not None and found.outcome.status is monitor.stopped and not found.success:
        with monitor.clock.during("audit"):
            found = monitor.to_its_end(lambda: back(first, found))
    if why:
        details |= {"chosen_by": name, "chosen": "; ".join((why, *found.details.get("said", ())))}
    return _made(chosen, found, first, begin, monitor, spent, details, seed, certify, bool(why))


def solve_by_options(
    problem: ContactProblem,
    formulation: str | Formulation | Chooser,
    options: Mapping[str, Any],
    *,
    on_step: OnStep | None = None,
    certify: bool = False,
) -> Solution:
    """:func:`solve` with options by name, see :func:`rmesh_nlp.solving.options.request`."""
    return solve(problem, **request(formulation, options), on_step=on_step, certify=certify)


def _by_settings(
    problem: ContactProblem,
    formulation: str | Formulation | Chooser,
    settings: dict[str, Any],
    limits: Limits | None,
    on_step: OnStep | None,
    certify: bool,
    asked: dict[str, Any],
) -> Solution:
    if not isinstance(formulation, str):
        example = f"{type(formulation).__name__}({next(iter(settings))}=...)"
        raise TypeError(f"settings are fields of the formulation: {example}")
    for old in LIMITS:
        if old in settings:
            warnings.warn(f"{old} is now a part of limits=Limits(...)", DeprecationWarning, stacklevel=3)
    if limits is not None:
        settings = {"time_limit_s": limits.seconds, "max_iterations": limits.iterations, **settings}
    return solve_by_options(problem, formulation, {**settings, **asked}, on_step=on_step, certify=certify)


def _chosen(
    asked: Formulation | Chooser, problem: ContactProblem, objective: Objective, is_started: bool
) -> tuple[Formulation, ContactProblem, str]:
    """A formulation, the problem as it is to be solved, and why; without a reason if it was asked for."""
    if isinstance(asked, Chooser):
        choice = asked.choose(problem, objective, is_started=is_started)
        return choice.formulation, choice.problem, choice.why
    if isinstance(asked, Wrapper):
        inner, stated, why = _chosen(asked.inner, problem, objective, is_started)
        return (asked if inner is asked.inner else replace(asked, inner=inner)), stated, why
    return asked, problem, ""


def _once(
    formulation: Formulation,
    problem: ContactProblem,
    objective: Objective,
    start: Start,
    seed: int | None,
    tolerance: float,
    monitor: Monitor,
) -> tuple[Outer, str, Assessment, Work]:
    """The outer problem, the name of the start, where the formulation ended, and the work until then."""
    clock, monitor.mesh = monitor.clock, problem.mesh
    with clock.during("build"):
        outer = Outer(problem, objective, tolerance)
    with clock.during("audit"):
        outer.knows(*timed(lambda: outer.contact.solve(np.asarray(problem.mesh.p))))
    with clock.during("build"):
        _ = outer.residual
    clock.enter("solve")
    begin = beginning(
        outer, start if formulation.relocates else None, seed if formulation.relocates else None, monitor
    )
    outcome = monitor.run(formulation, begin.outer, begin.q)
    spent = monitor.spent
    if not formulation.relocates:
        spent = replace(monitor.work, contact_solves=1, cold_contact_solves=1)
    if monitor.stopped is not None and formulation.relocates:  # one contact solve is finite
        outcome = replace(outcome, status=monitor.stopped)
    with clock.during("audit"):
        found = monitor.to_its_end(lambda: assess(outer, outcome, relocates=formulation.relocates))
    return outer, begin.name, found, spent


def _made(
    formulation: Formulation,
    found: Assessment,
    first: Outer,
    begin: str,
    monitor: Monitor,
    spent: Work,
    details: dict[str, Any],
    seed: int | None,
    certify: bool,
    reduces: bool,
) -> Solution:
    """The one place where a solution is made."""
    status, success, valid = found.status, found.success, found.valid
    extra = {**found.details, **details, **_counts(spent)}
    extra.pop("said", None)
    if monitor.limits.changed():
        extra["limits"] = monitor.limits.changed()
    fields = dict(found.fields)
    fields.setdefault("initial_nodes", np.asarray(fields["problem"].mesh.p))
    if fields.get("initial_areas") is None:
        fields["initial_areas"] = signed_areas(fields["problem"].mesh.p, fields["problem"].triangles)
    certificate = None
    with monitor.clock.during("audit"):
        try:
            if monitor.stopped is None and reduces:
                extra |= _reduction(found, extra, spent)
            if monitor.stopped is None:
                extra |= surviving_gain(found, extra.get("warnings", ()))
        except KeyboardInterrupt:  # the solution is there
            monitor.stopped = Status.INTERRUPTED
        if certify and monitor.stopped is not Status.INTERRUPTED:
            entries, certificate = certified(
                SimpleNamespace(**fields, status=status, assessed=found.assessed)
            )
            extra |= entries
            if certificate is not None and certificate.is_disproved:
                status, success, valid = Status.INACCURATE, False, False
            elif certificate is not None and "error_reduction" in extra:
                extra["error_reduction"] = certificate.of_reduction(extra["error_reduction"])
    if monitor.stopped is Status.INTERRUPTED and status is not Status.INTERRUPTED:
        if not success:
            fields["detail"] = f"That point is no success, {status.value}: {status.message}"
        status = Status.INTERRUPTED
    history = _ending(monitor, found)
    return Solution(
        **fields,
        formulation=formulation.name,
        status=status,
        valid=valid,
        improved=found.improved,
        success=success,
        history=history,
        iterations=monitor.iterations,
        contact_solves=spent.contact_solves,
        contact_time_s=first.contact_seconds,
        build_time_s=monitor.clock.seconds("build"),
        solve_time_s=monitor.clock.seconds("solve"),
        audit_time_s=monitor.clock.seconds("audit"),
        start=begin,
        settings=formulation.changed(),
        seed=seed if formulation.relocates else None,
        extra=extra,
        measured=found.measured,
        assessed=found.assessed,
        certificate=certificate,
    )


def _counts(spent: Work) -> dict[str, int]:
    """Record entries of work, those that were counted at all."""
    return {name: count for name, count in vars(spent).items() if name != "contact_solves" and count}


def _reduction(found: Assessment, extra: dict[str, Any], spent: Work) -> dict[str, Any]:
    """Record entries: by how much the error fell, and quantities on a refined mesh."""
    if found.assessed is None:
        return {}
    reduction, refined = error_reduction(*found.assessed, spent.contact_solves)
    entries: dict[str, Any] = {} if reduction is None else {"error_reduction": reduction.record()}
    if refined is not None:
        entries |= refined.entries("_refined")
        before, after = (
            Quantities(**{name: extra[name + suffix] for name in vars(refined)})
            for suffix in ("_initial", "")
        )
        entries["warnings"] = [*extra["warnings"], *worse(before, after, refined)]
    return entries


def _ending(monitor: Monitor, found: Assessment) -> tuple[Step, ...]:
    """The history, with the measured residual in its last step if that is where the solve ended.

    Where each step of an all-at-once solver would need an adjoint to know it, the history has this one only.
    """
    if not monitor.steps:
        return ()
    *steps, last = monitor.steps
    q, at = found.outcome.q, monitor.last_moves
    size = np.max(np.abs(q), initial=0.0)
    if (
        np.isnan(last.dual_residual)
        and at is not None
        and at.size == q.size
        and np.allclose(at, q, rtol=0.0, atol=1e-8 * size)
    ):
        last = replace(last, dual_residual=found.fields["stationarity_residual"])
    return (*steps, last)
