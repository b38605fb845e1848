"""All at once: the contact problem as KKT conditions, an MPCC in positions, displacement and forces.

The complementarity of contact and friction is relaxed with a parameter t, and t goes down from
``t0`` to the end, from the start that is given, for every outer objective. For the energy it ends
where ``joint`` does, and the multipliers of the equilibrium constraints vanish there (the term
with U' drops out, seen from the other side). It is meant for outer objectives for which the
levels do not collapse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from formulations import joint
from formulations.mpcc_options import OPTIONS, energy_options, other_options
from formulations.mpcc_start import Begin, begin, in_step, moves
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.mpcc import MPCC, MPCCResult, MPCCSolver
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.kkt_program import Bilevel, bilevel
from rmesh_nlp.solving.beginning import Start
from rmesh_nlp.solving.composed import composed
from rmesh_nlp.solving.history import TIME_LIMIT_S, Recorder, ending_with_residual
from rmesh_nlp.solving.referee import STATIONARY, OnStep, Referee
from rmesh_nlp.solving.regularised import Regularisation
from rmesh_nlp.solving.solution import Solution

LIMITS = (Status.TIME_LIMIT, Status.ITERATION_LIMIT)
"""Ends of a homotopy whose last point need not be complementary."""


def build(problem: ContactProblem, objective: str | Objective = "energy") -> MPCC:
    """The symbolic MPCC, see :mod:`rmesh_nlp.programs.kkt_program`; in N/m, m and the objective's unit."""
    return bilevel(problem, parse_objective(objective)).mpcc


@composed
def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    regularisation: Regularisation = None,
    distortion: str = "shape-size",
    flips: bool = False,
    relaxation: str = "scholtes",
    settings: Mapping[str, Any] | None = None,
    tolerance: float = STATIONARY,
    max_iterations: int | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    start: Start = None,
    seed: int | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Solve the MPCC by a homotopy of relaxations from ``start``, and an exact finish.

    Parameters
    ----------
    problem : ContactProblem
    objective : str or Objective
        Such as "energy", "error-l2 + 0.01*quality" or "mean(top, -uy)", see
        :mod:`rmesh_nlp.fem.objective_text`, or an object of :mod:`rmesh_nlp.fem.quantities`.
    regularisation : float or sequence of float, optional
        Weight of a distortion that is added to the energy, relative to the error of the energy on the mesh as
        given, or a schedule of weights of which the last may be 0; 0.01 suits most problems without boxes.
    distortion : str
        "quality", "shape-size" or "elastic", see :mod:`rmesh_nlp.fem.distortion`.
    flips : bool
        Flip edges by energy between relocations, until neither gains; without boxes only.
    relaxation : str
        A name in ``rmesh_nlp.mpcc.RELAXATIONS``.
    seed : int, optional
        Random start of the positions; by default the mesh as given.
    settings : mapping, optional
        Fields of :class:`rmesh_nlp.mpcc.Options`, on top of ``OPTIONS``.
    tolerance : float
        Largest first-order residual, measured by the referee, of a solution that is called converged.
    max_iterations : int, optional
        Ipopt iterations over all relaxations and branches.
    time_limit_s : float
        After it, as after Ctrl-C, the best valid mesh so far is the solution.
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
    at = moves(start, seed, referee, outer, time_limit_s)
    begun = at.q
    pull = joint.pull(referee.reduced(begun).gradient)
    if outer.is_energy:
        at = in_step(at, referee, start)
    contact = referee.reduced(at.q)
    function = referee.function(objective)
    value = function(np.zeros(at.q.size)).value
    with referee.clock.during("build"):
        two_level = bilevel(
            referee.discretisation,
            outer,
            length=float(np.max(np.abs(contact.equilibrium.u))) or 1.0,
            force=contact.system.force_scale,
            value=abs(value) or 1.0,
        )
    if outer.is_energy:
        boxed = bool(np.all(np.isfinite(referee.relocation.freedoms.bound)))
        own: dict[str, Any] = energy_options(two_level.value / pull, boxed)
    else:
        own = other_options()
    recorder = Recorder(referee, on_step, time_limit_s, two_level.value, outer.is_energy)
    if outer.is_energy:
        recorder.state_residual = _residual(referee, two_level)
    where = Begin(at.name, np.zeros(0))

    def run() -> MPCCResult | None:
        nonlocal where
        where = begin(start, referee, two_level, outer, at, recorder)
        recorder.after(where.iterations)
        if recorder.stopped is not None:
            return None
        limits = {"time_limit_s": max(recorder.remaining, 1e-3), "max_iterations": max_iterations}
        usual = {"relaxation": relaxation, **OPTIONS, **own, **limits}
        options = {**usual, **where.options, **(settings or {})}
        with referee.clock.during("build"):
            solver = MPCCSolver(two_level.mpcc, **options)
        return solver(where.x, on_iteration=recorder.iterate)

    result = recorder.run(run)
    steps = [*where.steps, *recorder.steps()]
    common: dict[str, Any] = {
        "objective": objective,
        "tolerance": tolerance,
        "history": steps,
        "start": where.name,
        "seed": seed,
        "settings": {**(settings or {}), **({"max_iterations": max_iterations} if max_iterations else {})},
    }
    if result is None or result.status in LIMITS:
        q = recorder.best(function, begun)
        return referee.judge(
            "mpcc",
            q,
            status=recorder.stopped or (Status.FAILED if result is None else result.status),
            iterations=steps[-1].iteration if steps else 0,
            contact_solves=where.contact_solves,
            stationarity="",
            extra={
                "objective_initial": value,
                "objective_value": function(q).value,
                "relaxation": relaxation,
            },
            **common,
        )
    q, u, normal, tangential = two_level.split(result.x)
    inside = np.clip(q, -referee.relocation.freedoms.bound, referee.relocation.freedoms.bound)
    solution = referee.judge(
        "mpcc",
        inside,
        status=result.status,
        iterations=where.iterations + result.counts["ipopt_iterations"],
        contact_solves=where.contact_solves,
        equilibrium=_equilibrium(referee, q, u, normal, tangential, result),
        stationarity=result.stationarity,
        extra={
            "objective_initial": value,
            "objective_value": function(inside).value,
            "relaxation": relaxation,
            "kkt_factorisations": result.counts["ipopt_iterations"]
            + (where.iterations if where.nlp_solves else 0),
            **_figures(referee, two_level, where, result),
        },
        **common,
    )
    known = outer.is_energy or not recorder.ended_at(inside)
    return solution if known else ending_with_residual(solution)


def _residual(referee: Referee, two_level: Bilevel) -> Callable[[Array], float]:
    """The first-order residual of the energy at unknowns of the MPCC, by its own displacement and forces."""
    residual, rows = referee.residual(referee.reduced), two_level.friction_rows

    def at(x: Array) -> float:
        q, u, normal, tangential = two_level.split(x)
        return residual.of_state(q, u, normal, tangential[rows])

    return at


def _figures(referee: Referee, two_level: Bilevel, where: Begin, result: MPCCResult) -> dict[str, Any]:
    """Record entries of the start, the homotopy and the label."""
    return {
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
