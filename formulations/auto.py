"""No strategy of its own: chooses strategy, weights, meshes and quadrature for a problem, and says so.

A problem without boxes is solved by ``nested`` with Newton-CG on the energy with a distortion, over a cascade
of coarser meshes (:mod:`rmesh_nlp.programs.cascade`), and with a quadrature rule that is raised until
the audit confirms the gain. Where boxes, a least angle or another objective are asked for, ``joint`` or
``nested`` is run, the latter with Newton-CG where many nodes have boxes. The record names what ran as its
``formulation``, ``chosen_by`` is "auto", and ``chosen`` says in words what was chosen and why.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from formulations import joint, nested
from rmesh_nlp.discretisation.freedoms import freedoms
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.nlp import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.cascade import CascadeResult, cascade
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.energy_flips import flips_and_moves
from rmesh_nlp.programs.energy_program import relocation
from rmesh_nlp.programs.large_moves import LargeMoves
from rmesh_nlp.programs.outer_solvers import StoppedError
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.regularisation import regularised, weights
from rmesh_nlp.programs.stationary import finished
from rmesh_nlp.settings import check_positive
from rmesh_nlp.solution.beginning import Start
from rmesh_nlp.solution.flipping import check_flips, with_flips
from rmesh_nlp.solution.history import TIME_LIMIT_S
from rmesh_nlp.solution.referee import STATIONARY, OnStep, Referee
from rmesh_nlp.solution.regularised import Regularisation
from rmesh_nlp.solution.solution import Solution, Step
from rmesh_nlp.solution.worth import worth

RULES = (6, 10, 14, 20)
"""Degrees of the quadrature rule that are tried in turn; the last one is that of the audit."""

AGREEMENT = 0.01
"""Largest difference of the gain by the rule and by the audit, in parts of the audited gain."""

CORRECTIONS = 10
"""Iterations of the descent that follows a change of the rule."""

MANY = 2000
"""Moves above which boxed problems are solved by Newton-CG: the time of ``joint`` grows like the square of
the number of nodes. On plates with two holes of 517 and 1,381 nodes both gain the same in the same time."""

ENOUGH = 1e-3
"""Part of the gain so far below which a predicted step is not worth taking, where there are many moves."""

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
    time_limit_s : float
        After it, as after Ctrl-C, the best mesh so far is the solution: coarsening and the statement of
        programs count, nothing more is stated than what the audit needs, and ``worth`` is not worked out.
    start, seed : optional
        With one of them the problem is solved from there, without a cascade: by Newton-CG with the same
        distortion where there are no boxes.
    on_step : callable, optional
        Called after each iteration, with the moves on the given mesh only.
    """
    check_positive(tolerance=tolerance, time_limit_s=time_limit_s)
    chosen = _weighted(CascadeSettings.of(settings), regularisation)
    common: dict[str, Any] = {
        "tolerance": tolerance,
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
        if freedoms(problem).n > MANY and not flips and regularisation is None:
            found = nested.solve(problem, outer="newton", settings={"enough": ENOUGH}, **common)
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
    found = _large_moves(problem, chosen, tolerance, time_limit_s, on_step)
    if found.status is Status.INTERRUPTED:
        return found
    if flips:
        found = _flipped(problem, found, chosen, tolerance, time_limit_s)
    return found if found.status is Status.TIME_LIMIT else _with_worth(problem, found)


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
        rule = found.problem.rule
        higher = [degree for degree in RULES if not isinstance(rule, int) or degree > rule]
        if _agrees(found) or not higher or found.status in (Status.TIME_LIMIT, Status.INTERRUPTED):
            return replace(found, extra={**found.extra, "rules": rules})
        rules.append(higher[0])
        if not options["flips"]:
            options = {**options, "start": found.mesh.p}


def _chosen(solution: Solution, why: str) -> Solution:
    return replace(solution, extra={**solution.extra, "chosen_by": "auto", "chosen": why})


def _with_worth(problem: ContactProblem, solution: Solution) -> Solution:
    """The solution with what it is worth in its record; the time for that counts as audit."""
    began = time.perf_counter()
    stated = replace(problem, quadrature=solution.problem.quadrature)
    energies = solution.energy_initial_audited, solution.audit.energy_audited
    try:
        found = worth(stated, solution.mesh, *energies, solution.contact_solves)
    except KeyboardInterrupt:  # the solution is there
        return replace(solution, status=Status.INTERRUPTED)
    if found is None:
        return solution
    return replace(
        solution,
        extra={**solution.extra, "worth": found.record()},
        audit_time_s=solution.audit_time_s + time.perf_counter() - began,
    )


def first_rule(problem: ContactProblem) -> str | int:
    """The rule to begin with: where a load varies an exact one of low degree, else degree 6 at least."""
    if not any(callable(component) for law in problem.laws for component in law.load):
        return problem.quadrature
    rule = problem.rule
    if not isinstance(rule, int):
        return RULES[0]
    return min(rule, RULES[0]) if problem.quadrature == "auto" else max(rule, RULES[0])


def _large_moves(
    problem: ContactProblem,
    settings: CascadeSettings,
    tolerance: float,
    time_limit_s: float,
    on_step: OnStep | None,
) -> Solution:
    rule = first_rule(problem)
    watch = _Watch(problem, time_limit_s, on_step)
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
            settings=settings.changed(),
            extra=_figures(result, rules, settings),
        )

    status = result.status if result else Status.FAILED
    while True:
        referee = Referee(stated, objective)
        solution = judged(referee, q, status)
        rule = stated.rule
        higher = [degree for degree in RULES if not isinstance(rule, int) or degree > rule]
        if watch.is_late() or _agrees(solution) or not higher or result is None:
            break
        rules.append(higher[0])
        stated = replace(problem, quadrature=higher[0])
        referee = Referee(stated, objective)
        q, status, more = _corrected(referee.reduced, q, result, settings, watch)
        solves += more
    residual = solution.stationarity_residual
    if result and not watch.is_late() and residual > tolerance and q.size and _is_small(problem, settings):
        began, before = time.process_time(), referee.reduced.contact_solves
        last = finished(
            referee.reduced,
            q,
            referee.residual(referee.reduced),
            tolerance=tolerance,
            reference=referee.reduced(q).value + result.gain_estimate,
            max_iterations=settings.finish,
            on_step=lambda iteration, x, value: watch(iteration, referee.reduced, x, value),
        )
        seconds = time.process_time() - began
        more = referee.reduced.contact_solves - before
        solves += more
        better = judged(referee, last.result.x, last.result.status)
        if better.success and (_agrees(better) or not _agrees(solution)):
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
    # never a mesh that is worse than the one given
    worse = not solution.energy_initial_audited >= solution.audit.energy_audited
    if worse and watch.stopped:
        solution = judged(referee, np.zeros(q.size), watch.stopped)
    elif worse:
        solution = nested.solve(stated, max_iterations=1, tolerance=tolerance)
        solution = replace(solution, extra={**solution.extra, **_figures(result, rules, settings)})
    seconds = watch.seconds
    return replace(solution, solve_time_s=seconds)


def _is_small(problem: ContactProblem, settings: CascadeSettings) -> bool:
    return bool(problem.mesh.p.shape[1] <= settings.stationary)


def _flipped(
    problem: ContactProblem,
    first: Solution,
    settings: CascadeSettings,
    tolerance: float,
    time_limit_s: float,
) -> Solution:
    """Flips and short descents in turn, from a solution; judged at the end only."""
    gain = first.extra.get("gain_estimate", 0.0)
    began, steps, solves = time.perf_counter(), list(first.history), 0
    spent = first.build_time_s + first.solve_time_s

    def relocate(flipped: ContactProblem) -> ContactProblem:
        nonlocal solves
        if spent + time.perf_counter() - began > time_limit_s:
            return flipped
        energy = ReducedEnergy(relocation(flipped, _weighted_objective(gain, settings)))
        q = np.zeros(energy.relocation.n_q)
        moves = LargeMoves(energy)
        result = moves(
            q,
            gain_tolerance=settings.end,
            reference=energy(q).value + gain,
            max_iterations=settings.brief,
        )
        solves += energy.contact_solves
        last = steps[-1].iteration if steps else 0
        point = energy(result.x)
        seconds = first.solve_time_s + time.perf_counter() - began
        steps.append(
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
    last, rounds = flips_and_moves(start, gain, relocate, given=problem)
    if not rounds:
        return first
    referee = Referee(last, _weighted_objective(gain, settings))
    energy, late = referee.reduced, first.status is Status.TIME_LIMIT
    q, status = np.zeros(energy.relocation.n_q), Status.TIME_LIMIT if late else Status.ITERATION_LIMIT
    if _is_small(problem, settings) and not late:
        end = finished(
            energy,
            q,
            referee.residual(energy),
            tolerance=tolerance,
            reference=energy(q).value + gain,
            max_iterations=settings.finish,
            on_step=lambda *_: spent + time.perf_counter() - began > time_limit_s,
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
        steps.append(after)
    final = referee.judge(
        "nested",
        q,
        status=status,
        tolerance=tolerance,
        objective=referee.relocation.objective,
        history=steps,
        iterations=steps[-1].iteration,
        contact_solves=first.contact_solves + solves + 3 * len(rounds),
        settings=settings.changed(),
        extra=dict(first.extra),
    )
    found = with_flips(replace(problem, quadrature=first.problem.quadrature), first, final, rounds)
    return replace(
        found,
        iterations=final.iterations,
        contact_solves=final.contact_solves,
        solve_time_s=first.solve_time_s + time.perf_counter() - began,
    )


def _weighted_objective(gain: float, settings: CascadeSettings) -> Objective:
    return regularised(gain, settings.regularisation, settings.distortion)


def _agrees(solution: Solution) -> bool:
    """Whether the gain by the problem's rule is the audited one, to 1 %."""
    audited = solution.energy_initial_audited - solution.audit.energy_audited
    return abs(solution.energy_initial - solution.energy - audited) <= AGREEMENT * abs(audited)


def _corrected(
    energy: ReducedEnergy, q: Array, result: CascadeResult, settings: CascadeSettings, watch: _Watch
) -> tuple[Array, Status, int]:
    """A few iterations with another rule, from where the last one led."""
    found = LargeMoves(energy)(
        q,
        gain_tolerance=settings.end,
        reference=energy(q).value + result.gain_estimate,
        max_iterations=CORRECTIONS,
        on_step=lambda iteration, x, value: watch(iteration, energy, x, value),
    )
    return found.x, found.status, energy.contact_solves


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


class _Watch:
    """History, time limit and last moves of a cascade, see :data:`rmesh_nlp.programs.cascade.OnMove`."""

    def __init__(self, problem: ContactProblem, limit: float, on_step: OnStep | None) -> None:
        self._nodes, self._limit, self._on_step = problem.mesh.p.shape[1], limit, on_step
        self._began = time.perf_counter()
        self._last: tuple[float, Array] | None = None
        self._before = self._iteration = 0
        self.steps: list[Step] = []
        self.stopped: Status | None = None

    @property
    def seconds(self) -> float:
        """Wall time so far."""
        return time.perf_counter() - self._began

    @property
    def iterations(self) -> int:
        """Over all meshes."""
        return max((step.iteration for step in self.steps), default=0)

    def __call__(self, iteration: int, energy: ReducedEnergy, q: Array, value: float) -> bool:
        if self.steps and iteration < self._iteration:  # another descent begins
            self._before = self.steps[-1].iteration
        self._iteration = iteration
        step = Step(
            iteration=self._before + iteration,
            energy=energy(q).equilibrium.energy,
            t=0.0,
            primal_residual=0.0,
            dual_residual=float("nan"),
            contact_solves=energy.contact_solves,
            seconds=self.seconds,
            objective=value,
        )
        self.steps.append(step)
        finest = energy.relocation.problem.mesh.p.shape[1] == self._nodes
        if finest:
            self._last = value, np.array(q)
        if self._on_step is not None:
            self._on_step(replace(step, q=np.array(q)) if finest else step)
        return self.is_late()

    def is_late(self) -> bool:
        """Whether the solve was stopped, or its time is up."""
        if self.stopped is None and self.seconds > self._limit:
            self.stopped = Status.TIME_LIMIT
        return self.stopped is not None

    def run(self, solve: Any) -> CascadeResult | None:
        """The result of ``solve``; None after Ctrl-C, and if the time was up before there was one."""
        try:
            result: CascadeResult = solve()
        except KeyboardInterrupt:
            self.stopped = Status.INTERRUPTED
            return None
        except StoppedError:
            return None
        return result

    def best(self, problem: ContactProblem) -> Array:
        """The last moves on the given mesh, which are the best; none if it was not reached."""
        return self._last[1] if self._last is not None else np.zeros(freedoms(problem).n)
