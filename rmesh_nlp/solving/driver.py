"""``solve``: the one driver of all formulations.

It chooses a formulation, builds the outer problem, runs the one on the other, measures where that ended and
compares it with the mesh as given. Where the gain is an error of the discretisation, it does so once more
with a safe one. Then it makes the solution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rmesh_nlp.errors import BadInputError, expect
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.budget import Limits, deferred, timed
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.certify import certified, estimated
from rmesh_nlp.solving.exploited import RunEnd, as_given, is_spurious, once_more
from rmesh_nlp.solving.formulation import Asked, Keywords
from rmesh_nlp.solving.monitor import Monitor, OnStep
from rmesh_nlp.solving.outer import TOLERANCE
from rmesh_nlp.solving.parts import Step, Trace
from rmesh_nlp.solving.plan import Plan, Start, beginning
from rmesh_nlp.solving.refinement import ReducedError, reduced_error, surviving_gain
from rmesh_nlp.solving.solution import Solution

MOST = 2000
"""Vertices of a mesh on which errors are estimated unasked: that takes 2 contact solves on small meshes, and
4 on larger ones."""

ENDED = "ended by the time limit, or by the user"
"""Remark in the place of a certificate, or of estimates."""

HIGHER = "the mesh is as it was given: the energy of the one that was reached is higher"


def solve(
    problem: ContactProblem,
    formulation: Asked = "auto",
    *,
    objective: str | Objective = "energy",
    start: Start = None,
    seed: int | None = None,
    tolerance: float = TOLERANCE,
    limits: Limits | Mapping[str, Any] | None = None,
    on_step: OnStep | None = None,
    certify: bool = False,
    audit: bool = True,
    **settings: Any,
) -> Solution:
    """Relocate the nodes of a problem and solve the contact problem there.

    Parameters
    ----------
    problem : ContactProblem
        What is solved.
    formulation : str or Formulation
        A name of :func:`rmesh_nlp.formulations`, or an object whose fields are its settings, such as
        ``Joint(first_barrier=1e-2)`` of ``formulations.joint``. ``auto`` chooses for the problem and the
        record has the reason; ``fixed`` moves no node, ``nested`` solves a contact problem per step,
        ``joint`` and ``mpcc`` find positions and displacement at once.
    objective : str or Objective
        What is minimised: "energy", another one such as "error-l2 + 0.01*quality" or "mean(top, -uy)", see
        :mod:`rmesh_nlp.fem.objective_text`, or an object of :mod:`rmesh_nlp.fem.quantities`.
    start : array (2, nodes), str or Solution, optional
        Positions of nodes, "given", a formulation that runs first, or a solution to go on from; by default
        the mesh as given, or with a ``seed`` a random one.
    seed : int, optional
        Random start; by default the mesh as given.
    tolerance : float
        Largest measured first-order residual of a solution that is called converged.
    limits : Limits or mapping of its fields, optional
        After them, as after Ctrl-C, the best valid mesh so far is the solution.
    on_step : callable, optional
        Called with each step of the history.
    certify : bool
        Bound the error of the solution: ``solution.certificate``.
    audit : bool
        Measure the energy of the continuous problem on both meshes. Without it the solution is what the
        formulation found, its status ``UNAUDITED`` and never a success.
    settings
        Of a formulation that is named: its settings, such as ``t0=0.1`` of ``mpcc``, and what takes one, such
        as ``remesh=True`` or ``starts=8``; :func:`rmesh_nlp.solving.formulation.options` has their names.

    Returns
    -------
    Solution
        Assessed by what is measured on the problem; see ``status`` and ``success``.

    Raises
    ------
    BadInputError
        If there is no such formulation, or it does not take the problem or an option.
    """
    expect("problem", problem, ContactProblem, ", which read_problem makes of a file")
    if not (on_step is None or callable(on_step)):
        raise BadInputError(f"on_step must be a function of a step, got {on_step!r}")
    Keywords(audit=audit)
    if certify and not audit:
        raise BadInputError("without an audit there is nothing to certify: leave out one of the two")
    monitor = Monitor(Limits.of(limits), on_step, problem.mesh)
    plan = Plan.of(
        problem, formulation, objective=objective, start=start, seed=seed, tolerance=tolerance, **settings
    )
    with monitor.budget.interruptible():
        end, safe = _ended(plan, plan.problem, monitor, audit), None
        if is_spurious(end.assessment):
            end, safe = once_more(end, lambda safely: _ended(plan, safely, monitor), monitor)
        stopped, reached = monitor.budget.stopped, end.assessment
        monitor.budget.keep(end.contact_seconds)
        if stopped is not None and reached.is_audited:
            if not reached.success and reached.solver_status is stopped:
                end = monitor.finish(lambda: as_given(end, stopped)) or end
        elif plan.why and reached.status in (Status.WORSE, Status.EXPLOITED):
            # what chooses by itself hands nothing back that is worse
            end = monitor.finish(lambda: as_given(end, Status.STALLED, HIGHER)) or end
        return _made(plan, end, safe, monitor, certify)


def _ended(plan: Plan, problem: ContactProblem, monitor: Monitor, audit: bool = True) -> RunEnd:
    """Where a formulation ends on a problem: built, run, measured.

    A model of the given mesh is built when the formulation first asks for it.
    """
    budget = monitor.budget
    with budget.during("build"):
        outer = plan.outer(problem)
    with budget.during("audit"):
        contact, nodes, before = outer.contact, problem.mesh.p, budget.seconds("audit")
        contact_seconds = timed(lambda: contact.given, again=lambda: contact.solve(nodes))
        # with a design the mesh as given is of another problem
        if audit and plan.formulation.relocates and not problem.design:
            budget.keep(contact_seconds)
            audit = monitor.finish(lambda: outer.initial) is not None
            budget.kept = 2 * (budget.seconds("audit") - before)  # of the final mesh and what compares them
    budget.enter("solve")
    begin, q, start = beginning(outer, plan.start, plan.seed, monitor)
    formulation = plan.formulation
    outcome = monitor.run(formulation, begin, q)
    spent = monitor.spent  # what the assessment solves is no part of it
    # the contact solve on the given mesh ends whatever the limit
    stopped = budget.stopped if formulation.relocates else None
    first = outer if formulation.relocates else outcome.outer  # else nothing moves: it is one mesh
    assessed = partial(assess, first, outcome, relocates=formulation.relocates)
    budget.keep(contact_seconds)
    assessment = monitor.finish(lambda: assessed(stopped=stopped, audit=audit))
    if assessment is None:
        with budget.during("audit"), deferred():
            assessment = assessed(stopped=budget.stopped, audit=False)
    return RunEnd(outer, outcome, assessment, start, spent, contact_seconds)


def _made(plan: Plan, end: RunEnd, safe: str | None, monitor: Monitor, certify: bool) -> Solution:
    """The one place where a solution is made."""
    assessment, certificate, remark, reduced = end.assessment, None, None, None
    budget = monitor.budget
    with budget.during("audit"):
        budget.kept = 0.0
        if plan.why:
            reduced = monitor.attempt(lambda: reduced_error(assessment, end.spent.contact_solves))
        surviving = monitor.attempt(lambda: surviving_gain(assessment))
        if certify and budget.stopped is not Status.INTERRUPTED:
            certificate, remark = monitor.finish(lambda: certified(assessment)) or (None, ENDED)
        details, final = end.outcome.details, assessment.final
        is_due = final.mesh.p.shape[1] <= MOST and budget.stopped is not Status.INTERRUPTED
        if is_due and final.problem.origin is None and assessment.success and "estimates" not in details:
            found = monitor.finish(lambda: estimated(end.outcome.outer, final, certificate))
            details = {**details, **({"estimates_remark": ENDED} if found is None else found)}
    why = "; ".join((plan.why, *end.outcome.remarks)) if plan.why else None
    return Solution(
        assessment=assessment,
        formulation=plan.formulation.name,
        trace=Trace(
            steps=_history(monitor, end),
            iterations=budget.iterations,
            work=end.spent,
            contact_time_s=end.contact_seconds,
            build_time_s=budget.seconds("build"),
            solve_time_s=budget.seconds("solve"),
            audit_time_s=budget.seconds("audit"),
        ),
        start=end.start,
        settings=plan.formulation.changed(),
        seed=plan.seed,
        limits=budget.limits,
        safe=safe,
        chosen_by=plan.chooser if why else None,
        chosen=why,
        details=details,
        reduced_error=reduced or ReducedError(),
        surviving_gain=surviving,
        certificate=certificate,
        certificate_remark=remark,
        is_interrupted=budget.stopped is Status.INTERRUPTED,
    )


def _history(monitor: Monitor, end: RunEnd) -> tuple[Step, ...]:
    """The history, with the measured residual in its last step if that is the solver's own end.

    Where each step of an all-at-once solver would need an adjoint to know it, the history has this one only.
    """
    steps = monitor.steps
    if steps and np.isnan(steps[-1].dual_residual) and end.outcome.own is not None:
        steps = [*steps[:-1], replace(steps[-1], dual_residual=end.assessment.first_order.residual)]
    return tuple(steps)
