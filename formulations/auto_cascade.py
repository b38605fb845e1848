"""Large moves without boxes: a cascade, a rule that the audit confirms, the way to a stationary point."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from formulations.auto_rules import agrees, first_rule, next_rule
from formulations.auto_watch import Watch
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.cascade import CascadeResult, cascade
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.large_moves import LargeMoves
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.regularisation import regularised
from rmesh_nlp.programs.stationary import Finish, finished
from rmesh_nlp.solving.clock import solving
from rmesh_nlp.solving.referee import OnStep, Referee
from rmesh_nlp.solving.solution import Solution, interrupted

SPARE = 6
"""Contact solves that one more iteration may take, steps that are refused included."""

CORRECTIONS = 10
"""Iterations of the descent that follows a change of the rule."""


def solve_by_cascade(
    problem: ContactProblem,
    settings: CascadeSettings,
    tolerance: float,
    max_iterations: int | None,
    time_limit_s: float,
    on_step: OnStep | None,
) -> Solution:
    """Solve without boxes over a cascade of meshes; the result is judged on the problem as given."""
    rule = first_rule(problem)
    watch = Watch(problem, settings, time_limit_s, on_step, max_iterations)
    stated = replace(problem, quadrature=rule)
    result = watch.run(lambda: cascade(stated, settings, watch, watch.is_late))
    objective = result.objective if result else "energy"
    solves = sum(level.contact_solves for level in result.levels) + 2 if result else 0
    q = watch.best(stated) if result is None else result.q
    rules = [rule]

    def judged(referee: Referee, q: Array, status: Status) -> Solution:
        return referee.judge(
            "nested",
            q if referee.is_valid(q) else np.zeros(q.size),
            status=watch.stopped or status,
            tolerance=tolerance,
            objective=objective,
            history=watch.steps,
            iterations=watch.iterations,
            contact_solves=solves,
            settings=watch.changed(),
            extra=_figures(result, rules, settings),
        )

    status = result.status if result else Status.FAILED
    while True:
        referee = watch.to_its_end(partial(Referee, stated, objective))
        solution = watch.to_its_end(partial(judged, referee, q, status))
        higher = next_rule(stated)
        if watch.is_late() or agrees(solution) or higher is None or result is None:
            break
        rules.append(higher)
        stated = replace(problem, quadrature=higher)
        referee = watch.to_its_end(partial(Referee, stated, objective))
        corrected = watch.run(partial(_corrected, referee.reduced, q, result, settings, watch))
        if corrected is None:  # stopped
            q = watch.best(stated)
            continue
        q, status, more = corrected
        solves += more
    residual = solution.stationarity_residual
    if result and not watch.is_late() and residual > tolerance and q.size and is_small(problem, settings):
        began, before = time.process_time(), referee.reduced.contact_solves
        last = watch.run(partial(_finished, referee, q, result, settings, tolerance, watch, solves))
        if last is None:  # stopped
            q, status = watch.best(stated), Status.FAILED
        else:
            q, status = last.result.x, last.result.status
        seconds = time.process_time() - began
        more = referee.reduced.contact_solves - before
        solves += more
        better = watch.to_its_end(partial(judged, referee, q, status))
        if better.success and (agrees(better) or not agrees(solution)):
            solution = better
            if last is not None:
                figures = {
                    "iterations": last.result.iterations,
                    "products": last.result.products,
                    "contact_solves": more,
                    "factorisations": last.factorisations,
                    "seconds": seconds,
                }
                solution = replace(better, extra={**better.extra, "finish": figures})
    if watch.is_late() and solution.status not in (Status.CONVERGED, watch.stopped) and solution.valid:
        # the time was up on the way to a point that was not taken
        solution = replace(solution, status=watch.stopped or solution.status)
    if not solution.success and watch.stopped:
        solution = judged(referee, np.zeros(q.size), watch.stopped)
    if watch.stopped is Status.INTERRUPTED:  # perhaps after the verdict
        solution = interrupted(solution)
    seconds = solving(watch.seconds, solution.build_time_s, solution.audit_time_s)
    return replace(solution, solve_time_s=seconds)


def is_small(problem: ContactProblem, settings: CascadeSettings) -> bool:
    """Whether the descent goes on until the solution is stationary."""
    return bool(problem.mesh.p.shape[1] <= settings.stationary)


def weighted_objective(gain: float, settings: CascadeSettings) -> Objective:
    """The energy with the distortion, weighted by the settings' part of the estimated gain."""
    return regularised(gain, settings.regularisation, settings.distortion)


def _corrected(
    energy: ReducedEnergy, q: Array, result: CascadeResult, settings: CascadeSettings, watch: Watch
) -> tuple[Array, Status, int]:
    """A few iterations with another rule, from where the last one led."""
    found = LargeMoves(energy, approximate=True)(
        q,
        gain_tolerance=settings.end,
        reference=energy(q).value + result.gain_estimate,
        max_iterations=CORRECTIONS,
        on_step=lambda iteration, x, value: watch(iteration, energy, x, value),
    )
    return found.x, found.status, energy.contact_solves


def _finished(
    referee: Referee,
    q: Array,
    result: CascadeResult,
    settings: CascadeSettings,
    tolerance: float,
    watch: Watch,
    spent: int,
) -> Finish:
    """The way to a stationary point from the end of the cascade, after ``spent`` contact solves."""
    energy = referee.reduced
    last = energy.contact_solves + max(settings.most - spent - SPARE, 1)

    def is_over(iteration: int, x: Array, value: float) -> bool:
        return watch(iteration, energy, x, value, ends=False) or energy.contact_solves >= last

    found = finished(
        energy,
        q,
        referee.residual(energy),
        tolerance=tolerance,
        reference=energy(q).value + result.gain_estimate,
        max_iterations=settings.finish,
        on_step=is_over,
    )
    if found.result.status is Status.INTERRUPTED and watch.stopped is None:
        return replace(found, result=replace(found.result, status=Status.ITERATION_LIMIT))
    return found


def _figures(
    result: CascadeResult | None, rules: list[str | int], settings: CascadeSettings
) -> dict[str, Any]:
    """Record entries: what was chosen, and what each mesh took."""
    figures: dict[str, Any] = {
        "chosen_by": "auto",
        "chosen": "nested, newton: large moves without boxes over a cascade of meshes",
        "outer": "newton",
        "regularisation": settings.regularisation,
        "distortion": settings.distortion,
        "rules": rules,
        "stationary_for": f"the energy with {settings.distortion} weighted {settings.regularisation:g} of "
        "its estimated error",
    }
    if result is not None:
        levels = result.record()
        figures |= {
            "chosen": f"{figures['chosen']} of {', '.join(str(level['nodes']) for level in levels)} nodes"
            + _damped(result),
            "cascade": levels,
            "gain_estimate": result.gain_estimate,
        }
    return figures


def _damped(result: CascadeResult) -> str:
    """Of which prolonged maps only a part was taken, in words; empty if there are none."""
    parts = [f"{level.taken:g} on {level.nodes} nodes" for level in result.levels if level.taken < 1]
    if not parts:
        return ""
    return f"; of a prolonged map a part was taken ({', '.join(parts)}), since more did not lower the energy"
