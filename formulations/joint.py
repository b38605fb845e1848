"""All at once without complementarity: min over (X, u) of the energy.

Outer and inner objective are the same energy, so the bilevel problem collapses to one NLP.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rmesh_nlp.evaluation import Array
from rmesh_nlp.history import Recorder
from rmesh_nlp.nlp import NLP, Solver, Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.referee import OnStep, Referee
from rmesh_nlp.relocation import relocation
from rmesh_nlp.solution import Solution

OPTIONS: Mapping[str, Any] = {
    "max_iter": 3000,
    # Many boxes are weakly active, and an interior point meets those only to the square root of
    # its tolerance; where rounding stops it before, 1e-9 will do.
    "tol": 1e-12,
    "compl_inf_tol": 1e-12,
    "acceptable_tol": 1e-9,
}
"""Ipopt options that add to ``rmesh_nlp.nlp.IPOPT_OPTIONS``."""


def build(problem: ContactProblem) -> NLP:
    """The symbolic NLP in ``x = (q, u, s)``, see :mod:`rmesh_nlp.relocation`.

    Extend it with :meth:`rmesh_nlp.nlp.NLP.extended`, or hand ``x``, ``f`` and ``g`` to any
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
    nlp = build(problem)
    recorder = Recorder(on_step, referee.relocation.n_q)
    solver = Solver(nlp, options={**OPTIONS, **(options or {})}, monitor=recorder)
    q = referee.start(seed, start)
    contact = referee.reduced(q)
    result = solver(referee.reduced.point(q, contact.equilibrium))
    seconds = time.perf_counter() - began
    q, _, _ = referee.relocation.split(result.x)
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
