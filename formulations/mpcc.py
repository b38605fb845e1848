"""All at once: the contact problem as KKT conditions, an MPCC in positions, displacement and forces.

The complementarity of contact and friction is relaxed with a parameter t, and t goes down from
``t0`` to the end, from the start that is given, for every outer objective. For the energy it ends
where ``joint`` does, and the multipliers of the equilibrium constraints vanish there (the term
with U' drops out, seen from the other side). It is meant for outer objectives for which the
levels do not collapse.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from formulations.mpcc_start import Begin, Start, begin
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.mpcc import MPCC, MPCCResult, MPCCSolver
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.kkt_program import Bilevel, bilevel
from rmesh_nlp.programs.reduced import ReducedEnergy, ReducedObjective
from rmesh_nlp.solution.history import Recorder
from rmesh_nlp.solution.referee import OnStep, Referee
from rmesh_nlp.solution.solution import Solution


def _close(mu: float, push: float) -> dict[str, Any]:
    """Ipopt options that stay in the basin of a start close to a solution.

    A large barrier, or the push of the start off its bounds, would lose it.
    """
    pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
    return {"mu_strategy": "monotone", "mu_init": mu, **dict.fromkeys(pushes, push)}


OPTIONS: Mapping[str, Any] = {
    "t0": 1e-2,
    "factor": 0.1,
    "t_final": 1e-9,
    "crossover": 1e-2,
    "warm_duals": True,
    "ipopt_relaxed": _close(1e-6, 1e-6),
    # Many node boxes are weakly active, and an interior point meets those only to the square
    # root of its tolerance.
    "ipopt_exact": {"tol": 1e-12, "compl_inf_tol": 1e-12, **_close(1e-9, 1e-9)},
}
"""Options of :class:`rmesh_nlp.mpcc.Options` for mesh problems. t is in units of the largest displacement
on the given mesh times its largest nodal load."""


def build(problem: ContactProblem, objective: str | Objective = "energy") -> MPCC:
    """The symbolic MPCC, see :mod:`rmesh_nlp.programs.kkt_program`; in N/m, m and the objective's unit."""
    return bilevel(problem, parse_objective(objective)).mpcc


def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    relaxation: str = "scholtes",
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    start: Start = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Solve the MPCC by a homotopy of relaxations from ``start``, and an exact finish.

    Parameters
    ----------
    problem : ContactProblem
    objective : str or Objective
        Such as "energy", "error-l2 + 0.01*quality" or "mean(top, -uy)", see
        :mod:`rmesh_nlp.fem.objective_text`, or an object of :mod:`rmesh_nlp.fem.quantities`.
    relaxation : str
        A name in ``rmesh_nlp.mpcc.RELAXATIONS``.
    seed : int, optional
        Random start of the positions; by default the mesh as given.
    options : mapping, optional
        Fields of :class:`rmesh_nlp.mpcc.Options`, on top of ``OPTIONS``.
    start : str, (2, nodes) array or Solution, optional
        "given", the default: the contact solution on the mesh as given, or at the random positions of the
        seed. Node positions: the contact solution there. The other starts solve something else
        first, and only the last relaxation and the exact finish follow, which certify where
        it ended as a solution of the MPCC, or leave it: "joint" (the energy program; energy only),
        "nested" (exact contact solves), "without-complementarity" (the MPCC with the products
        dropped), or a Solution of any strategy. ``extra["start"]`` of the record names the start.
    on_step : callable, optional
        Called after each Ipopt iteration.

    Raises
    ------
    ValueError
        If the objective, the relaxation or the start is unknown or does not fit.
    """
    outer = parse_objective(objective)
    referee = Referee(problem)
    began = time.perf_counter()
    q = referee.start(seed, start if isinstance(start, np.ndarray) else None)
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
    recorder = Recorder(on_step, q.size, two_level.value, outer.is_energy)
    where = begin(start, seed, referee, two_level, outer, contact, recorder)
    recorder.after(where.iterations)
    settings = {"relaxation": relaxation, **OPTIONS, **where.options, **(options or {})}
    result = MPCCSolver(two_level.mpcc, **settings)(where.x, on_iteration=recorder.iterate)
    seconds = time.perf_counter() - began
    q, u, normal, tangential = two_level.split(result.x)
    inside = np.clip(q, -referee.relocation.freedoms.bound, referee.relocation.freedoms.bound)
    return referee.judge(
        "mpcc",
        inside,
        status=result.status,
        history=[*where.steps, *recorder.steps()],
        iterations=where.iterations + result.counts["ipopt_iterations"],
        contact_solves=where.contact_solves,
        wall_time_s=seconds,
        objective=objective,
        equilibrium=_equilibrium(referee, q, u, normal, tangential, result),
        stationarity=result.stationarity,
        seed=seed,
        outer_gradient=function(inside).gradient,
        extra={
            "objective_initial": value,
            "objective_value": function(inside).value,
            "relaxation": relaxation,
            **_figures(referee, two_level, where, result),
        },
    )


def _figures(referee: Referee, two_level: Bilevel, where: Begin, result: MPCCResult) -> dict[str, Any]:
    """Record entries of the start, the homotopy and the label."""
    return {
        "start": where.name,
        "stages": [
            {
                "phase": nlp.phase,
                "t": nlp.t,
                "product": nlp.product,
                "biactive": nlp.biactive,
                "multiplier": nlp.multiplier,
                "iterations": nlp.iterations,
                "seconds": nlp.seconds,
                "status": nlp.status.value,
            }
            for nlp in result.history
        ],
        "label": result.label,
        "b_stationary": result.b_stationary,
        "biactive": int(result.biactive.size),
        "biactive_nodes": _nodes(referee, two_level, result),
        "equilibrium_multiplier": float(np.max(np.abs(result.lam_g[: two_level.n_u]))),
        "constraint_violation": result.constraint_violation,
        "complementarity": result.complementarity,
        "nlp_solves": where.nlp_solves + result.counts["nlp_solves"],
        "rescues": result.counts["rescues"],
    }


def _equilibrium(
    referee: Referee, q: Array, u: Array, normal: Array, tangential: Array, result: MPCCResult
) -> Equilibrium:
    """The MPCC's own displacement and forces, to be audited as they are."""
    system = referee.model.system(referee.relocation.nodes(q))
    slip = system.tangents @ u if system.slip_bound.size else np.zeros(0)
    active = ActiveSet(normal > 0, np.sign(slip).astype(np.int8))
    return Equilibrium(u, system.energy(u), normal, tangential, active, result.status, 0)


def _nodes(referee: Referee, two_level: Bilevel, result: MPCCResult) -> list[int]:
    """Mesh nodes of the biactive pairs."""
    gaps, slips = referee.model.contact_nodes, referee.model.contact_nodes[two_level.friction_rows]
    of_pair = np.concatenate([gaps, slips, slips])
    return sorted({int(node) for node in of_pair[result.biactive]})
