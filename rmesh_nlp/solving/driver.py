"""``solve``: the one driver of all formulations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import check_positive
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.certify import certified
from rmesh_nlp.solving.clock import TOLERANCE, Limits
from rmesh_nlp.solving.epigraph import with_levels
from rmesh_nlp.solving.exploited import (
    SAFE_DEGREE,
    End,
    back,
    better,
    damped,
    is_spurious,
    reduced_error,
    safe_discretisation,
    surviving_gain,
)
from rmesh_nlp.solving.formulation import Choice, Chooser, Formulation, Wrapper, composed
from rmesh_nlp.solving.monitor import Monitor, OnStep
from rmesh_nlp.solving.options import Start, beginning, request, with_settings
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Choices, Step
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
        ``remesh=True``, ``starts=8``. ``time_limit_s`` and ``max_iterations``, the limits of 0.1, still work
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
        named = {"objective": objective, "start": start, "seed": seed, "tolerance": tolerance}
        keywords = with_settings(formulation, settings, limits, named)
        return solve(problem, **keywords, on_step=on_step, certify=certify)
    check_positive(tolerance=tolerance)
    monitor, outer_objective = Monitor(limits, on_step), parse_objective(objective)
    problem = with_levels(problem, outer_objective)
    asked = composed(formulation, {}) if isinstance(formulation, str) else formulation
    choice = _chosen(asked, problem, outer_objective, start is not None or seed is not None)
    chosen = choice.formulation
    _check_energy(problem, outer_objective, chosen)
    chosen.accepts(choice.problem, outer_objective)
    if not chosen.relocates:
        start = seed = None
    outer = _outer(choice.problem, outer_objective, tolerance, monitor)
    end, safe = _ended(chosen, outer, start, seed, monitor), None
    if is_spurious(end.found):
        end, safe = _safe(chosen, end, start, seed, monitor)
    if monitor.stopped is not None and end.outcome.status is monitor.stopped and not end.found.success:
        end = monitor.finish(lambda: back(end))
    why = "; ".join((choice.why, *end.outcome.remarks)) if choice.why else None
    choices = Choices(safe, asked.name if why else None, why)
    return _made(chosen, end, seed, monitor, choices, certify)


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


def _check_energy(problem: ContactProblem, objective: Objective, formulation: Formulation) -> None:
    """Raise a BadInputError where an energy is to be minimised that there is not."""
    energies = [term.name for _, term in objective.terms if term.name == "energy"]
    if not (energies and formulation.relocates):
        return
    example = (
        f"which the objective {objective.text!r} would need: state another one, such as 'mean(top, -uy)'"
    )
    if problem.has_coulomb:
        raise BadInputError(f"with Coulomb friction no energy is minimised, {example}")
    if problem.design or problem.constraints:
        raise BadInputError(f"energies of different designs do not compare, {example}")


def _chosen(
    asked: Formulation | Chooser, problem: ContactProblem, objective: Objective, is_started: bool
) -> Choice:
    """A formulation, the problem as it is to be solved, and why; without a reason if it was asked for."""
    if isinstance(asked, Chooser):
        return asked.choose(problem, objective, is_started=is_started)
    if isinstance(asked, Wrapper):
        choice = _chosen(asked.inner, problem, objective, is_started)
        same = choice.formulation is asked.inner
        return replace(choice, formulation=asked if same else replace(asked, inner=choice.formulation))
    return Choice(asked, problem, "")


def _outer(problem: ContactProblem, objective: Objective, tolerance: float, monitor: Monitor) -> Outer:
    """The outer problem, with the contact solution on the mesh as given and its time.

    A model of the given mesh is built when a formulation first asks for it.
    """
    clock, monitor.mesh = monitor.clock, problem.mesh
    with clock.during("build"):
        outer = Outer(problem, objective, tolerance)
    with clock.during("audit"):
        outer.time_contact()
    return outer


def _ended(formulation: Formulation, outer: Outer, start: Start, seed: int | None, monitor: Monitor) -> End:
    """Where a formulation ends, assessed."""
    monitor.clock.enter("solve")
    begin = beginning(outer, start, seed, monitor)
    outcome = monitor.run(formulation, begin.outer, begin.q)
    spent = monitor.spent  # what the assessment solves is no part of it
    if monitor.stopped is not None and formulation.relocates:  # one contact solve is finite
        outcome = replace(outcome, status=monitor.stopped)
    found = monitor.finish(lambda: assess(outer, outcome, relocates=formulation.relocates))
    return End(outer, outcome, found, begin.name, spent)


def _safe(
    formulation: Formulation, end: End, start: Start, seed: int | None, monitor: Monitor
) -> tuple[End, str]:
    """The better end of a second solve with a safe discretisation, or a part of the way to the first one."""
    first, last, measured = end.first, end.outcome.outer.problem, end.found.measured
    said = f"{measured.costliest} was exploited" if measured else ""
    if monitor.stopped is None and safe_discretisation(last) is not last:
        safe = safe_discretisation(first.problem)  # as it was given: the end may be on a finer mesh
        second = _ended(
            formulation, _outer(safe, first.objective, first.tolerance, monitor), start, seed, monitor
        )
        end = replace(better(end, second), spent=second.spent)
        said += f", solved again with a rule of degree {SAFE_DEGREE} and gaps along edges"
    if end.found.status is Status.EXPLOITED:
        end, part = monitor.finish(lambda: damped(end))
        said += f", and {part:g} of the way to the last mesh taken" if part < 1 else ""
    return end, said


def _made(
    formulation: Formulation, end: End, seed: int | None, monitor: Monitor, choices: Choices, certify: bool
) -> Solution:
    """The one place where a solution is made."""
    found, certificate, remark, reduction = end.found, None, None, None
    with monitor.clock.during("audit"):
        if choices.chosen is not None:
            reduced = monitor.attempt(lambda: reduced_error(end.found, end.spent))
            found, reduction = reduced or (found, None)
        found = monitor.attempt(lambda: surviving_gain(end.outcome, found)) or found
        if certify and monitor.stopped is not Status.INTERRUPTED:
            certificate, remark = certified(found)
    if certificate is not None and certificate.is_disproved:
        found = replace(found, status=Status.INACCURATE, success=False, valid=False)
    if monitor.stopped is Status.INTERRUPTED and found.status is not Status.INTERRUPTED:
        said = f"That point is no success, {found.status.value}: {found.status.message}"
        found = replace(found, status=Status.INTERRUPTED, detail=found.detail if found.success else said)
    return Solution(
        **vars(found),
        formulation=formulation.name,
        history=_history(monitor, end),
        iterations=monitor.iterations,
        work=end.spent,
        contact_time_s=end.first.contact_seconds,
        build_time_s=monitor.clock.seconds("build"),
        solve_time_s=monitor.clock.seconds("solve"),
        audit_time_s=monitor.clock.seconds("audit"),
        start=end.start,
        settings=formulation.changed(),
        seed=seed,
        limits=monitor.limits,
        choices=choices,
        error_reduction=reduction,
        certificate=certificate,
        certificate_remark=remark,
    )


def _history(monitor: Monitor, end: End) -> tuple[Step, ...]:
    """The history, with the measured residual in its last step if that is where the solve ended.

    Where each step of an all-at-once solver would need an adjoint to know it, the history has this one only.
    """
    if not monitor.steps:
        return ()
    *steps, last = monitor.steps
    q, at = end.outcome.q, monitor.last_q
    size = np.max(np.abs(q), initial=0.0)
    if (
        np.isnan(last.dual_residual)
        and at is not None
        and at.size == q.size
        and np.allclose(at, q, rtol=0.0, atol=1e-8 * size)
    ):
        last = replace(last, dual_residual=end.found.stationarity_residual)
    return (*steps, last)
