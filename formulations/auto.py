"""No strategy of its own: chooses strategy, weights, meshes and quadrature for a problem, and says so.

A problem without boxes is solved by ``nested`` with Newton-CG on the energy with a distortion, over a cascade
of coarser meshes (:mod:`rmesh_nlp.programs.cascade`), and with a quadrature rule that is raised until
the audit confirms the gain. Where boxes, a least angle or another objective are asked for, ``joint`` or
``nested`` is run, the latter with Newton-CG where many nodes have boxes. The record names what ran as its
``formulation``, ``chosen_by`` is "auto", and ``chosen`` says in words what was chosen and why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from formulations import joint, nested
from formulations.auto_cascade import solve_by_cascade
from formulations.auto_flips import with_edges_flipped
from formulations.auto_rules import agrees, first_rule, next_rule
from rmesh_nlp.discretisation.freedoms import freedoms
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.regularisation import weights
from rmesh_nlp.settings import check_limits
from rmesh_nlp.solving.beginning import Start
from rmesh_nlp.solving.flipping import check_flips
from rmesh_nlp.solving.history import TIME_LIMIT_S
from rmesh_nlp.solving.reducing import with_error_reduction
from rmesh_nlp.solving.referee import STATIONARY, OnStep
from rmesh_nlp.solving.regularised import Regularisation
from rmesh_nlp.solving.solution import Solution, interrupted

MANY = 2000
"""Moves above which boxed problems are solved by Newton-CG: the time of ``joint`` grows like the square of
the number of nodes. On plates with two holes of 517 and 1,381 nodes both gain the same in the same time."""

ENOUGH = 1e-3
"""Part of the gain so far below which a predicted step is not worth taking, for 20,000 moves. It grows with
the moves, since a step costs more of them: see :func:`enough_for`."""

ENOUGH_MOVES = 20_000
"""Moves up to which ``ENOUGH`` is taken as it is."""

SCHEDULE = (1.0, 0.1, 0.01)
"""Weights of the distortion where constraints must hold and ``joint`` is run."""


def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    settings: CascadeSettings | Mapping[str, Any] | None = None,
    regularisation: Regularisation = None,
    flips: bool = False,
    tolerance: float = STATIONARY,
    max_iterations: int | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    start: Start = None,
    seed: int | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Relocate the nodes of any problem; nothing needs to be chosen.

    Parameters
    ----------
    problem : ContactProblem
    objective : str or Objective
        The energy; with another one ``nested`` is run as it is.
    settings : CascadeSettings or mapping, optional
        Of the cascade, where it runs.
    regularisation : float or sequence of float, optional
        Final weight of the distortion in the place of that of the settings, or a whole schedule.
    flips : bool
        Flip edges by energy between relocations, until neither gains; without boxes only.
    tolerance : float
        Largest first-order residual, of the energy with the distortion, of a solution that is called
        converged. Up to ``settings.stationary`` nodes the descent goes on until then; larger meshes get a few
        iterations only, so that their solutions are successes that are not.
    max_iterations : int, optional
        Of what runs; of a cascade over all its meshes together, after which it ends as by the time limit.
    time_limit_s : float
        After it, as after Ctrl-C, the best mesh so far is the solution: coarsening and the statement of
        programs count. Only the final assessment runs; the error reduction is not estimated.
    start, seed : optional
        With one of them the problem is solved from there, without a cascade: by Newton-CG with the same
        distortion where there are no boxes.
    on_step : callable, optional
        Called after each iteration, with the moves on the given mesh only.
    """
    along = with_edge_gaps(problem)
    if along is not problem:
        found = solve(
            along,
            objective=objective,
            settings=settings,
            regularisation=regularisation,
            flips=flips,
            tolerance=tolerance,
            max_iterations=max_iterations,
            time_limit_s=time_limit_s,
            start=start,
            seed=seed,
            on_step=on_step,
        )
        return _chosen(
            found, f"{found.extra.get('chosen', 'auto')}; gaps along edges: a foundation is curved"
        )
    check_limits(tolerance=tolerance, max_iterations=max_iterations, time_limit_s=time_limit_s)
    chosen = _weighted(CascadeSettings.of(settings), regularisation)
    common: dict[str, Any] = {
        "tolerance": tolerance,
        "max_iterations": max_iterations,
        "time_limit_s": time_limit_s,
        "start": start,
        "seed": seed,
        "on_step": on_step,
    }
    motion = problem.motion
    if flips:
        check_flips(problem)
    if str(objective) != "energy":
        found = nested.solve(
            problem, objective=objective, flips=flips, regularisation=regularisation, **common
        )
        return _chosen(found, "nested: the objective is not the energy")
    if motion.delta is not None:
        moves = freedoms(problem).n
        if moves > MANY and not flips and regularisation is None:
            found = nested.solve(problem, outer="newton", settings={"enough": enough_for(moves)}, **common)
            return _chosen(found, f"nested, newton: nodes have boxes, and more than {MANY} moves are many")
        found = joint.solve(problem, flips=flips, regularisation=regularisation, **common)
        return _chosen(found, "joint: nodes have boxes")
    if motion.min_angle > 0:
        found = _confirmed(problem, {"regularisation": regularisation or SCHEDULE, "flips": flips, **common})
        return _chosen(
            found, "joint, regularised: a least angle is asked for, which must hold as a constraint"
        )
    if start is not None or seed is not None:
        options: dict[str, Any] = {"regularisation": chosen.regularisation, "distortion": chosen.distortion}
        found = nested.solve(problem, outer="newton", flips=flips, **options, **common)
        return _chosen(found, "nested, newton: large moves from the start that was given")
    if freedoms(problem).n == 0:
        return _chosen(nested.solve(problem, **common), "nested: no node can move")
    found = solve_by_cascade(problem, chosen, tolerance, max_iterations, time_limit_s, on_step)
    if found.status is Status.INTERRUPTED:
        return found
    if flips and (max_iterations is None or found.iterations < max_iterations):
        try:
            found = with_edges_flipped(problem, found, chosen, tolerance, time_limit_s, on_step)
        except KeyboardInterrupt:  # what was there before the flips is
            return interrupted(found)
    stopped = found.status in (Status.TIME_LIMIT, Status.INTERRUPTED)
    return found if stopped else with_error_reduction(found)


def enough_for(moves: int) -> float:
    """Part of the gain so far below which a predicted step is not worth taking."""
    return ENOUGH * max(1.0, moves / ENOUGH_MOVES)


def _weighted(settings: CascadeSettings, regularisation: Regularisation) -> CascadeSettings:
    """The settings with another final weight, or with another schedule."""
    if regularisation is None:
        return settings
    *before, last = weights(regularisation)
    schedules = (tuple(before),) if before else settings.schedules
    return replace(settings, regularisation=last, schedules=schedules)


def _confirmed(problem: ContactProblem, options: dict[str, Any]) -> Solution:
    """By ``joint``, with a rule that the audit confirms; a higher one begins from the mesh of the last."""
    rules = [first_rule(problem)]
    while True:
        found = joint.solve(replace(problem, quadrature=rules[-1]), **options)
        higher = next_rule(found.problem)
        if agrees(found) or higher is None or found.status in (Status.TIME_LIMIT, Status.INTERRUPTED):
            return replace(found, extra={**found.extra, "rules": rules})
        rules.append(higher)
        if not options["flips"]:
            options = {**options, "start": found.mesh.p}


def _chosen(solution: Solution, why: str) -> Solution:
    return replace(solution, extra={**solution.extra, "chosen_by": "auto", "chosen": why})
