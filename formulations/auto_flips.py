"""Flips of edges and short descents in turn, after large moves."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from formulations.auto_cascade import is_small, weighted_objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.energy_flips import flips_and_moves
from rmesh_nlp.programs.energy_program import relocation
from rmesh_nlp.programs.large_moves import LargeMoves
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.stationary import finished
from rmesh_nlp.solving.clock import solving
from rmesh_nlp.solving.flipping import with_flips
from rmesh_nlp.solving.interrupts import deferred
from rmesh_nlp.solving.referee import OnStep, Referee
from rmesh_nlp.solving.solution import Solution, interrupted
from rmesh_nlp.solving.step import Step


def with_edges_flipped(
    problem: ContactProblem,
    first: Solution,
    settings: CascadeSettings,
    tolerance: float,
    time_limit_s: float,
    on_step: OnStep | None = None,
) -> Solution:
    """Flips and short descents in turn, from a solution; judged at the end only.

    Ctrl-C ends them at the next iteration, as the time limit does, and the mesh so far is judged; a second
    one ends them without a solution.

    Raises
    ------
    KeyboardInterrupt
        After a second Ctrl-C.
    """
    with deferred() as pressed:
        return _with_edges_flipped(problem, first, settings, tolerance, time_limit_s, on_step, pressed)


def _with_edges_flipped(
    problem: ContactProblem,
    first: Solution,
    settings: CascadeSettings,
    tolerance: float,
    time_limit_s: float,
    on_step: OnStep | None,
    pressed: Callable[[], bool],
) -> Solution:
    gain = first.extra.get("gain_estimate", 0.0)
    began, steps, solves = time.perf_counter(), list(first.history), 0
    spent = first.build_time_s + first.solve_time_s

    def is_over() -> bool:
        return pressed() or spent + time.perf_counter() - began > time_limit_s

    def note(step: Step) -> None:
        steps.append(step)
        if on_step is not None:
            on_step(step)

    def relocate(flipped: ContactProblem) -> ContactProblem:
        nonlocal solves
        if is_over():
            return flipped
        energy = ReducedEnergy(relocation(flipped, weighted_objective(gain, settings)))
        q = np.zeros(energy.relocation.n_q)
        moves = LargeMoves(energy, approximate=True)
        result = moves(
            q,
            gain_tolerance=settings.end,
            reference=energy(q).value + gain,
            max_iterations=settings.brief,
            on_step=lambda *_: is_over(),
        )
        solves += energy.contact_solves
        last = steps[-1].iteration if steps else 0
        point = energy(result.x)
        seconds = first.solve_time_s + time.perf_counter() - began
        note(
            Step(
                iteration=last + result.iterations,
                energy=point.equilibrium.energy,
                t=0.0,
                primal_residual=0.0,
                dual_residual=float("nan"),
                contact_solves=solves,
                seconds=seconds,
                objective=point.value,
            )
        )
        return replace(flipped, mesh=replace(flipped.mesh, doflocs=energy.relocation.nodes(result.x)))

    start = replace(first.problem, mesh=first.mesh)
    last, rounds = flips_and_moves(start, gain, relocate, given=problem, stop=is_over)
    if not rounds:
        return interrupted(first) if pressed() else first
    referee = Referee(last, weighted_objective(gain, settings))
    energy, late = referee.reduced, first.status is Status.TIME_LIMIT
    q, status = np.zeros(energy.relocation.n_q), Status.TIME_LIMIT if late else Status.ITERATION_LIMIT
    if is_small(problem, settings) and not late and not pressed():
        end = finished(
            energy,
            q,
            referee.residual(energy),
            tolerance=tolerance,
            reference=energy(q).value + gain,
            max_iterations=settings.finish,
            on_step=lambda *_: is_over(),
        )
        q, status = end.result.x, end.result.status
        solves += energy.contact_solves
        after = replace(
            steps[-1],
            iteration=steps[-1].iteration + end.result.iterations,
            energy=energy(q).equilibrium.energy,
            objective=end.result.value,
            contact_solves=solves,
            seconds=first.solve_time_s + time.perf_counter() - began,
        )
        note(after)
    final = referee.judge(
        "nested",
        q,
        status=Status.INTERRUPTED if pressed() else status,
        tolerance=tolerance,
        objective=referee.relocation.objective,
        history=steps,
        iterations=steps[-1].iteration,
        contact_solves=first.contact_solves + solves + 3 * len(rounds),
        settings=settings.changed(),
        extra=dict(first.extra),
    )
    found = with_flips(replace(problem, quadrature=first.problem.quadrature), first, final, rounds)
    if pressed():
        found = interrupted(found)
    return replace(
        found,
        iterations=final.iterations,
        contact_solves=final.contact_solves,
        build_time_s=first.build_time_s + final.build_time_s,
        solve_time_s=first.solve_time_s
        + solving(time.perf_counter() - began, final.build_time_s, final.audit_time_s),
        audit_time_s=first.audit_time_s + final.audit_time_s,
    )
