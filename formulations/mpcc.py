"""All at once: the contact problem as KKT conditions, an MPCC in positions, displacement and forces.

For the energy objective it agrees with ``joint`` and the multipliers of the equilibrium
constraints vanish (the term with U' drops out, seen from the other side). It is meant for outer
objectives for which the levels do not collapse.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from formulations import joint
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objectives import parse_objective
from rmesh_nlp.mpcc import MPCC, MPCCResult, MPCCSolver
from rmesh_nlp.optimize.nlp import Solver
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.kkt_program import Bilevel, bilevel
from rmesh_nlp.programs.reduced import ReducedEnergy, ReducedObjective
from rmesh_nlp.solution.history import Recorder
from rmesh_nlp.solution.referee import OnStep, Referee
from rmesh_nlp.solution.solution import Solution, Step


def _close(mu: float, push: float) -> dict[str, Any]:
    """Ipopt options that stay in the basin of a start close to a solution.

    A large barrier, or the push of the start off its bounds, would lose it.
    """
    pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
    return {"mu_strategy": "monotone", "mu_init": mu, **dict.fromkeys(pushes, push)}


OPTIONS: Mapping[str, Any] = {
    "t0": 1e-4,
    "factor": 1e-3,
    "t_final": 1e-9,
    "crossover": 1.0,
    "ipopt_relaxed": _close(1e-6, 1e-6),
    # Many node boxes are weakly active, and an interior point meets those only to the square
    # root of its tolerance.
    "ipopt_exact": {"tol": 1e-12, "compl_inf_tol": 1e-12, **_close(1e-9, 1e-9)},
}
"""Options of :class:`rmesh_nlp.mpcc.Options` for mesh problems."""

FIRST_OPTIONS: Mapping[str, Any] = {"tol": 1e-8, "mu_strategy": "adaptive", "max_iter": 1000}
"""Ipopt options of the first solve, without complementarity."""


def _after_energy(scaling: float) -> dict[str, Any]:
    """Options from the minimiser of the energy program on.

    It is complementary, so the homotopy begins at its end. With the objective scaled and the
    barrier left about where that program left them, each slack times its multiplier is still
    the barrier: Ipopt goes on from there, as if it had been given the multipliers.
    """
    ipopt = {
        "tol": 1e-8,
        "obj_scaling_factor": scaling,
        "bound_mult_init_method": "mu-based",
        **_close(joint.OPTIONS["tol"], 1e-13),
    }
    return {**OPTIONS, "t0": OPTIONS["t_final"], "ipopt_relaxed": ipopt, "ipopt_exact": ipopt}


def build(problem: ContactProblem, objective: str = "energy") -> MPCC:
    """The symbolic MPCC, see :mod:`rmesh_nlp.programs.kkt_program`; in N/m, m and the objective's unit."""
    return bilevel(problem, parse_objective(objective)).mpcc


def solve(
    problem: ContactProblem,
    *,
    objective: str = "energy",
    relaxation: str = "scholtes",
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    start: Array | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Solve the MPCC by a homotopy of relaxations and an exact finish.

    The homotopy begins at t = infinity, with the complementarity dropped: that program is the
    same for every relaxation, so all of them go to the same minimum. For the energy it is
    already the answer, and it is the program of ``joint`` with equilibrium, a consequence of
    optimality there, written down as constraints. So for the energy ``joint``'s program is
    solved in its place, at a quarter of the time per iteration (no third derivatives, no
    equations). The contact problem at its moves gives the forces; the relaxation at the final t
    and the exact finish, which would leave this point if it were not a solution of the MPCC,
    verify it and give its multipliers and label. ``extra["first"]`` of the record names the
    program that was solved first.

    Parameters
    ----------
    problem : ContactProblem
    objective : str
        Terms of :mod:`rmesh_nlp.fem.objectives`, such as "energy" or "error-l2 + 0.01*quality".
    relaxation : str
        A name in ``rmesh_nlp.mpcc.RELAXATIONS``.
    seed : int, optional
        Random start of the positions; by default the initial mesh.
    options : mapping, optional
        Fields of :class:`rmesh_nlp.mpcc.Options`.
    start : (2, nodes) array, optional
        Node positions to start from, say prolonged from a coarser mesh.
    on_step : callable, optional
        Called after each iteration of the first solve, and with the steps of the homotopy.

    Raises
    ------
    ValueError
        If the objective or the relaxation is unknown.
    """
    outer = parse_objective(objective)
    referee = Referee(problem)
    began = time.perf_counter()
    q = referee.start(seed, start)
    contact = referee.reduced(q)
    function: ReducedEnergy | ReducedObjective = referee.reduced
    if not outer.is_energy:
        function = ReducedObjective(referee.reduced, outer)
    value = function(np.zeros(q.size)).value
    two_level = bilevel(
        problem,
        outer,
        length=float(np.max(np.abs(contact.equilibrium.u))) or 1.0,
        force=contact.system.force_scale,
        value=abs(value) or 1.0,
    )
    recorder = Recorder(on_step, referee.relocation.n_q, 1.0 if outer.is_energy else float("nan"))
    settings: Mapping[str, Any] = OPTIONS
    if outer.is_energy:
        settings = _after_energy(two_level.value / joint.pull(contact.gradient))
        first = joint.minimise(referee, q, recorder)
        contact = referee.reduced(first.x[: q.size] if first.converged else q)
        x = two_level.point(contact.q, contact.equilibrium, contact.system)
    else:
        first = Solver(two_level.without_complementarity(), options=FIRST_OPTIONS, monitor=recorder)(
            two_level.point(q, contact.equilibrium, contact.system)
        )
        x = first.x
    solver = MPCCSolver(two_level.mpcc, **{"relaxation": relaxation, **settings, **(options or {})})
    result = solver(x)
    seconds = time.perf_counter() - began
    unit = two_level.value if outer.is_energy else float("nan")
    unrelaxed = [replace(step, t=float("inf")) for step in recorder.steps(first)]
    history = unrelaxed + _homotopy_steps(unrelaxed[-1], result, unit)
    if on_step is not None:
        for step in history[len(unrelaxed) :]:
            on_step(step)
    q, u, normal, tangential = two_level.split(result.x)
    inside = np.clip(q, -referee.relocation.freedoms.bound, referee.relocation.freedoms.bound)
    return referee.judge(
        "mpcc",
        inside,
        status=result.status,
        history=history,
        iterations=first.iterations + result.counts["ipopt_iterations"],
        contact_solves=2 if outer.is_energy else 1,
        wall_time_s=seconds,
        objective=objective,
        equilibrium=_equilibrium(referee, q, u, normal, tangential, result),
        stationarity=result.stationarity,
        seed=seed,
        outer_gradient=function(inside).gradient,
        extra={
            "first": "energy program" if outer.is_energy else "without complementarity",
            "relaxation": relaxation,
            "objective_initial": value,
            "objective_value": function(inside).value,
            "b_stationary": result.b_stationary,
            "biactive": int(result.biactive.size),
            "biactive_nodes": _nodes(referee, two_level, result),
            "equilibrium_multiplier": float(np.max(np.abs(result.lam_g[: two_level.n_u]))),
            "constraint_violation": result.constraint_violation,
            "complementarity": result.complementarity,
            "nlp_solves": 1 + result.counts["nlp_solves"],
        },
    )


def _equilibrium(
    referee: Referee, q: Array, u: Array, normal: Array, tangential: Array, result: MPCCResult
) -> Equilibrium:
    """The MPCC's own displacement and forces, to be audited as they are."""
    system = referee.model.system(referee.relocation.nodes(q))
    slip = system.tangents @ u if system.slip_bound.size else np.zeros(0)
    active = ActiveSet(normal > 0, np.sign(slip).astype(np.int8))
    return Equilibrium(u, system.energy(u), normal, tangential, active, result.status, 0)


def _homotopy_steps(before: Step, result: MPCCResult, unit: float) -> list[Step]:
    """One step per NLP of the homotopy and of the exact finish (t = 0)."""
    iterations, seconds = before.iteration, before.seconds
    steps = []
    for nlp in result.history:
        iterations += nlp.iterations
        seconds += nlp.seconds
        violation, pairs = nlp.constraint_violation, nlp.complementarity
        steps.append(Step(iterations, nlp.objective * unit, nlp.t, violation, pairs, 0, seconds))
    return steps


def _nodes(referee: Referee, two_level: Bilevel, result: MPCCResult) -> list[int]:
    """Mesh nodes of the biactive pairs."""
    contact = result.biactive % max(two_level.n_contact, 1)
    return sorted({int(node) for node in referee.model.contact_nodes[contact]})
