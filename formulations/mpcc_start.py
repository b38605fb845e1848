"""Where the homotopy of ``mpcc`` begins: the start that is given, or the end of another program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from formulations import joint
from formulations.mpcc_options import PUSHES
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.programs.alternating import alternated
from rmesh_nlp.programs.kkt_program import Bilevel
from rmesh_nlp.programs.reduced import ReducedPoint
from rmesh_nlp.solving.beginning import GIVEN, Beginning, Start, beginning
from rmesh_nlp.solving.history import Recorder
from rmesh_nlp.solving.referee import Referee
from rmesh_nlp.solving.step import Step

DROPPED = "without-complementarity"
"""A start of ``mpcc`` alone: its program with the products dropped."""

CERTIFY: Mapping[str, Any] = {"t0": 1e-9, "t_final": 1e-9}
"""Options after another program: only the relaxation at the final t, and the exact finish."""

DROPPED_OPTIONS: Mapping[str, Any] = {"tol": 1e-8, "mu_strategy": "adaptive", "max_iter": 1000}
"""Ipopt options of the program without complementarity."""


@dataclass(frozen=True)
class Begin:
    """The point to begin from and what it cost.

    Attributes
    ----------
    name : str
        What the record calls it.
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
    referee: Referee,
    two_level: Bilevel,
    outer: Objective,
    where: Beginning,
    recorder: Recorder,
) -> Begin:
    """The unknowns of the MPCC to start from.

    Parameters
    ----------
    where : Beginning
        The moves to start from, see :func:`moves`.
    """
    contact = referee.reduced(where.q)
    here = two_level.point(contact.q, contact.equilibrium, contact.system)
    if isinstance(start, str) and start == "joint":
        return _joint(referee, two_level, outer, contact, recorder)
    if isinstance(start, str) and start == DROPPED:
        program = Solver(two_level.without_complementarity(), options=DROPPED_OPTIONS, monitor=recorder)
        first = program(here)
        steps = recorder.steps(first)
        return Begin(start, first.x, CERTIFY, steps, first.iterations, nlp_solves=1)
    if where.solution is None:
        return Begin(where.name, here)
    before = where.solution if isinstance(start, str) else None
    options = _after_energy(two_level.value / joint.pull(contact.gradient)) if outer.is_energy else CERTIFY
    return Begin(
        where.name,
        here,
        options,
        [] if before is None else list(before.history),
        where.iterations,
        where.contact_solves + 2,
    )


def moves(start: Start, seed: int | None, referee: Referee, outer: Objective, limit: float) -> Beginning:
    """The moves to start from.

    Those of "joint" and ``DROPPED`` are the given ones: their programs are solved once the MPCC is stated.

    Raises
    ------
    ValueError
        If the start is unknown or does not suit the objective or the mesh.
    """
    if isinstance(start, str) and start in ("joint", DROPPED):
        if start == "joint" and not outer.is_energy:
            raise ValueError("start = 'joint' needs the energy as objective: there alone the levels collapse")
        return beginning(referee, None, seed)
    return beginning(referee, start, seed, known=(DROPPED,), objective=outer, time_limit_s=limit)


def in_step(
    at: Beginning, referee: Referee, start: Start, usual: joint.JointSettings | None = None
) -> Beginning:
    """The moves to start from on a fine mesh in boxes: with small alternating moves added.

    They are those of ``joint`` (:mod:`rmesh_nlp.programs.alternating`), from the same number of moves on,
    so that both begin on the same mesh; the contact problem is solved there. Starts that were asked for
    by name or by positions stay as they are.
    """
    relocation, usual = referee.relocation, usual or joint.JointSettings()
    asked_for = start is not None and not (isinstance(start, str) and start == GIVEN)
    if asked_for or relocation.n_valid > 0 or at.q.size < usual.fine:
        return at
    gradient = referee.reduced(at.q).gradient
    return replace(at, q=alternated(relocation, at.q, gradient, usual.alternating, referee.is_valid))


def _joint(
    referee: Referee, two_level: Bilevel, outer: Objective, contact: ReducedPoint, recorder: Recorder
) -> Begin:
    """The minimiser of the energy program, with the forces of the contact problem there."""
    energies = Recorder(referee, recorder.on_step, recorder.limit)
    first = joint.minimise(referee, contact.q, energies)
    recorder.stopped = energies.stopped
    q = contact.q.size
    end = referee.reduced(first.x[:q] if first.converged else contact.q)
    x = two_level.point(end.q, end.equilibrium, end.system)
    options = _after_energy(two_level.value / joint.pull(contact.gradient))
    return Begin("joint", x, options, energies.steps(first), first.iterations, 2, 1)


def _after_energy(scaling: float) -> dict[str, Any]:
    """Options from the minimiser of the energy program, or another strategy's, on.

    With the objective scaled and the barrier left about where that program left them, each
    slack times its multiplier is still the barrier: Ipopt goes on from there, as if it had been
    given the multipliers.
    """
    ipopt = {
        "tol": 1e-8,
        "obj_scaling_factor": scaling,
        "bound_mult_init_method": "mu-based",
        "mu_strategy": "monotone",
        "mu_init": joint.JointSettings.tol,
        **dict.fromkeys(PUSHES, 1e-13),
    }
    # many boxes are weakly active: an interior point meets those only to the root of its tolerance
    exact = {**ipopt, "tol": 1e-11, "acceptable_tol": 1e-7}
    return {**CERTIFY, "ipopt_relaxed": ipopt, "ipopt_exact": exact}
