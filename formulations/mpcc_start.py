"""Where the homotopy of ``mpcc`` begins: the start that is given, or the end of another program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from formulations import joint, nested
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.nlp import Solver
from rmesh_nlp.programs.kkt_program import Bilevel
from rmesh_nlp.programs.reduced import ReducedPoint
from rmesh_nlp.solution.history import Recorder
from rmesh_nlp.solution.referee import Referee
from rmesh_nlp.solution.solution import Solution, Step

STARTS = ("given", "joint", "nested", "without-complementarity")
"""Starts that have a name."""

Start = str | Array | Solution | None
"""A name in ``STARTS``, node positions (2, nodes), a Solution, or None for "given"."""

CERTIFY: Mapping[str, Any] = {"t0": 1e-9, "t_final": 1e-9}
"""Options after another program: only the relaxation at the final t, and the exact finish."""

DROPPED_OPTIONS: Mapping[str, Any] = {"tol": 1e-8, "mu_strategy": "adaptive", "max_iter": 1000}
"""Ipopt options of the program without complementarity."""

PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")


@dataclass(frozen=True)
class Begin:
    """The point to begin from and what it cost.

    Attributes
    ----------
    name : str
        What the record calls it: a name in ``STARTS``, "random", "positions", or "solution of ...".
    x : array
        Unknowns of the MPCC.
    options : mapping
        Options of the homotopy that suit this start.
    steps : list of Step
        History of what was solved before.
    iterations, contact_solves, nlp_solves : int
    """

    name: str
    x: Array
    options: Mapping[str, Any] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    iterations: int = 0
    contact_solves: int = 1
    nlp_solves: int = 0


def begin(
    start: Start,
    seed: int | None,
    referee: Referee,
    two_level: Bilevel,
    outer: Objective,
    contact: ReducedPoint,
    recorder: Recorder,
) -> Begin:
    """The unknowns of the MPCC to start from.

    Parameters
    ----------
    contact : ReducedPoint
        Contact solution at the moves that positions or seed ask for.

    Raises
    ------
    ValueError
        If the start is unknown or does not suit the objective or the mesh.
    """
    here = two_level.point(contact.q, contact.equilibrium, contact.system)
    if start is None or isinstance(start, np.ndarray):
        positions = isinstance(start, np.ndarray)
        return Begin("positions" if positions else "given" if seed is None else "random", here)
    if isinstance(start, Solution):
        return _of_solution(start, referee, two_level)
    if start == "given":
        return Begin("given" if seed is None else "random", here)
    if start == "joint":
        return _joint(referee, two_level, outer, contact, recorder)
    if start == "nested":
        return _nested(referee, two_level, outer, contact)
    if start == "without-complementarity":
        program = Solver(two_level.without_complementarity(), options=DROPPED_OPTIONS, monitor=recorder)
        first = program(here)
        steps = recorder.steps(first)
        return Begin(start, first.x, CERTIFY, steps, first.iterations, nlp_solves=1)
    raise ValueError(f"unknown start {start!r}: choose from {', '.join(STARTS)}, positions or a Solution")


def _joint(
    referee: Referee, two_level: Bilevel, outer: Objective, contact: ReducedPoint, recorder: Recorder
) -> Begin:
    """The minimiser of the energy program, with the forces of the contact problem there."""
    if not outer.is_energy:
        raise ValueError("start = 'joint' needs the energy as objective: there alone the levels collapse")
    energies = Recorder(recorder.on_step, contact.q.size)
    first = joint.minimise(referee, contact.q, energies)
    q = contact.q.size
    end = referee.reduced(first.x[:q] if first.converged else contact.q)
    x = two_level.point(end.q, end.equilibrium, end.system)
    options = _after_energy(two_level.value / joint.pull(contact.gradient))
    return Begin("joint", x, options, energies.steps(first), first.iterations, 2, 1)


def _after_energy(scaling: float) -> dict[str, Any]:
    """Options from the minimiser of the energy program on.

    With the objective scaled and the barrier left about where that program left them, each
    slack times its multiplier is still the barrier: Ipopt goes on from there, as if it had been
    given the multipliers.
    """
    ipopt = {
        "tol": 1e-8,
        "obj_scaling_factor": scaling,
        "bound_mult_init_method": "mu-based",
        "mu_strategy": "monotone",
        "mu_init": joint.OPTIONS["tol"],
        **dict.fromkeys(PUSHES, 1e-13),
    }
    return {**CERTIFY, "ipopt_relaxed": ipopt, "ipopt_exact": ipopt}


def _nested(referee: Referee, two_level: Bilevel, outer: Objective, contact: ReducedPoint) -> Begin:
    """The end of the nested strategy from the same moves."""
    solver = "newton" if outer.is_energy else "ipopt"
    positions = referee.relocation.nodes(contact.q)
    first = nested.solve(referee.problem, objective=outer.text, outer=solver, start=positions)
    begun = _of_solution(first, referee, two_level)
    return Begin("nested", begun.x, CERTIFY, list(first.history), first.iterations, first.contact_solves)


def _of_solution(solution: Solution, referee: Referee, two_level: Bilevel) -> Begin:
    """The contact solution on the mesh of a Solution."""
    if solution.mesh.p.shape != referee.problem.mesh.p.shape:
        raise ValueError(
            f"the start has {solution.mesh.p.shape[1]} nodes, the problem {referee.problem.mesh.p.shape[1]}"
        )
    end = referee.reduced(referee.start(None, np.asarray(solution.mesh.p)))
    x = two_level.point(end.q, end.equilibrium, end.system)
    return Begin(f"solution of {solution.formulation}", x, CERTIFY, contact_solves=2)
