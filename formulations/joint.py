"""All at once without complementarity: min over (X, u) of the energy.

Outer and inner objective are the same energy, so the bilevel problem collapses to one NLP.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.nlp import NLP, NLPResult, Solver, Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.alternating import alternated
from rmesh_nlp.programs.energy_program import relocation
from rmesh_nlp.programs.reduced import ReducedPoint
from rmesh_nlp.solution.history import Recorder
from rmesh_nlp.solution.referee import OnStep, Referee
from rmesh_nlp.solution.solution import Solution

OPTIONS: Mapping[str, Any] = {
    "max_iter": 3000,
    # Ipopt would add a factor of its own, which depends on the unit of force.
    "nlp_scaling_method": "none",
    # In units of `pull`. Many boxes are weakly active, and an interior point meets those only to
    # the square root of its tolerance; where rounding stops it before, 1e-7 will do.
    "tol": 1e-10,
    "acceptable_tol": 1e-7,
    # Start in the middle of the boxes and let the moves choose their corners as the barrier
    # falls; with a small barrier they choose too early.
    "mu_init": 2.0,
    "bound_mult_init_method": "mu-based",
    # The energy is concave in some direction at nearly every iterate, so the Hessian is shifted.
    # A shift within a factor 1.5 of the least one takes half of the steps that Ipopt's own
    # search, within a factor 8, needs, and repays the factorisations that it costs.
    "perturb_dec_fact": 0.2,
    "perturb_inc_fact": 1.5,
}
"""Ipopt options on top of ``rmesh_nlp.optimize.nlp.IPOPT_OPTIONS``; ``solve`` adds ``obj_scaling_factor``."""

WITH_AREAS: Mapping[str, Any] = {
    "max_iter": 3000,
    "nlp_scaling_method": "none",
    "tol": 1e-12,
    "compl_inf_tol": 1e-12,
    "acceptable_tol": 1e-9,
}
"""The same where element areas are constraints, in units of `half_energy`: in those of `pull` the rounding of
the forces can be above every tolerance, and Ipopt's restoration then leaves the minimiser and ends as
infeasible (6.2 on 36 x 18 squares). docs/speed.md has the remedies that were tried."""

FINE = 3000
"""Number of moves from which on the start is given alternating moves (:mod:`rmesh_nlp.programs.alternating`):
the end is then lower by 0.1 to 0.7 % of the gain. On coarser meshes they change nothing but the start."""

ALTERNATING = 0.3
"""Length of these moves, in boxes."""


def build(problem: ContactProblem) -> NLP:
    """The symbolic NLP in ``x = (q, u, s)``, see :mod:`rmesh_nlp.programs.energy_program`.

    Extend it with :meth:`rmesh_nlp.optimize.nlp.NLP.extended`, or hand ``x``, ``f`` and ``g`` to any
    CasADi solver.
    """
    return relocation(problem).nlp


def solve(
    problem: ContactProblem,
    *,
    objective: str = "energy",
    seed: int | None = None,
    options: Mapping[str, Any] | None = None,
    start: Array | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Minimise the energy over node positions and displacement together, by Ipopt.

    Parameters
    ----------
    problem : ContactProblem
    objective : str
        Only "energy": with any other outer objective the levels do not collapse.
    seed : int, optional
        Random start; by default the initial mesh.
    options : mapping, optional
        Ipopt options.
    start : (2, nodes) array, optional
        Node positions to start from, say prolonged from a coarser mesh.
    on_step : callable, optional
        Called after each Ipopt iteration.

    Raises
    ------
    ValueError
        If the objective is not the energy.
    """
    if objective != "energy":
        raise ValueError(
            f"joint minimises the energy only, not {objective!r}: with another outer objective the inner "
            "problem must stay a constraint; use mpcc or nested"
        )
    referee = Referee(problem)
    began = time.perf_counter()
    recorder = Recorder(on_step, referee.relocation.n_q)
    result = minimise(referee, referee.start(seed, start), recorder, options)
    seconds = time.perf_counter() - began
    bound = referee.relocation.freedoms.bound
    q = np.clip(result.x[: bound.size], -bound, bound)  # Ipopt may leave its bounds by 2e-12
    status = Status.CONVERGED if result.converged else result.status
    return referee.judge(
        "joint",
        q,
        status=status,
        history=recorder.steps(result),
        iterations=result.iterations,
        contact_solves=1,
        wall_time_s=seconds,
        claimed_energy=result.f,
        seed=seed,
    )


def minimise(
    referee: Referee, q: Array, recorder: Recorder, options: Mapping[str, Any] | None = None
) -> NLPResult:
    """Solve the energy program from moves ``q`` and the contact solution there; see ``FINE``."""
    contact, relocation = referee.reduced(q), referee.relocation
    if relocation.n_valid:
        usual, unit = WITH_AREAS, half_energy(contact)
    else:
        usual, unit = OPTIONS, pull(contact.gradient)
        if relocation.n_q >= FINE:
            q = alternated(relocation, q, contact.gradient, ALTERNATING, referee.is_valid)
            contact = referee.reduced(q)
    solver = Solver(
        build(referee.problem),
        options={**usual, "obj_scaling_factor": 1 / unit, **(options or {})},
        monitor=recorder,
    )
    return solver(referee.reduced.point(q, contact.equilibrium))


def pull(gradient: Array) -> float:
    """The unit of the objective in which a barrier of order one suits the moves.

    Three times the mean of the gradient in the moves; 1 where nothing pulls. For the energy it
    falls like the gain per node, by a factor near 20 with every halving of the mesh size, while
    Ipopt's barrier and tolerances are absolute.
    """
    return 3 * float(np.mean(np.abs(gradient))) if np.any(gradient) else 1.0


def half_energy(point: ReducedPoint) -> float:
    """Half the size of the energies in a contact solution, which may cancel in their sum; 1 where all vanish.

    Ipopt's tolerances and barrier are absolute. Of 1, 2, 5 and 10 parts of the energy two gave the
    least iterations and energies on the examples and the gallery.
    """
    u = point.equilibrium.u
    return 0.5 * max(abs(point.value), 0.5 * float(u @ (point.system.stiffness @ u))) or 1.0
