"""What follows an exploited end: the problem once more with a safe discretisation, or a part of the way.

Where an optimiser has lived on an error of the discretisation, so that the continuous energy rose or most of
the gain is none, the problem is solved again with a rule for the loads of high degree and with gaps that hold
along edges. The end of lower continuous energy is the solution. If that is an exploited one as well, as much
of the way to its mesh is taken as lowers the continuous energy most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.assessment.conclusion import ROUNDING
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.judgement import Judgement, judged
from rmesh_nlp.solving.outer import Outer

SAFE_DEGREE = 20
"""Degree of the rule of the second solve."""

SURVIVES = 0.5
"""Least part of a gain by a formulation's own measure that must be one of the continuous energy."""

PARTS = tuple(0.5**k for k in range(1, 7))
"""Parts of the way to an exploited mesh that are tried."""


def is_hollow(found: Judgement) -> bool:
    """Whether the energy rose, or most of the gain is an error of the discretisation."""
    if found.status is Status.EXPLOITED:
        return True
    measured = found.measured
    if not found.success or measured is None or not measured.is_energy:
        return False
    rounding = ROUNDING * measured.size
    return measured.gain > rounding and measured.gain_audited < SURVIVES * measured.gain - rounding


def better(first: Judgement, second: Judgement) -> Judgement:
    """Of two ends the successful one of lower continuous energy; the second one if it was interrupted."""
    if not first.success or second.outcome.status is Status.INTERRUPTED:
        return second
    if not second.success:
        return first
    worse = second.fields["audit"].energy_audited > first.fields["audit"].energy_audited
    return first if worse else second


def safe_discretisation(problem: ContactProblem) -> ContactProblem:
    """The problem with accurate loads and gaps along edges; as it is if it has both."""
    safe = with_edge_gaps(problem)
    rule = safe.rule
    return safe if isinstance(rule, int) and rule >= SAFE_DEGREE else safe.with_rule(SAFE_DEGREE)


def damped(first: Outer, found: Judgement) -> tuple[Judgement, float]:
    """The part of the way from the given mesh to the last one that lowers the continuous energy most.

    Returns the judgement there, or the same one with part 1 if no part lowers it, or edges were flipped.
    """
    outcome = found.outcome
    problem, given = outcome.outer.problem, np.asarray(outcome.outer.problem.mesh.p)
    if found.assessed is None or "initial_nodes" in found.fields:
        return found, 1.0
    way, energies = outcome.outer.nodes(outcome.q) - given, {}
    for part in PARTS:
        there = admissible(problem, given + part * way)
        if there.status is Status.CONVERGED:
            energies[part] = there.energy
    best = min(energies, key=energies.__getitem__, default=1.0)
    if best == 1.0 or not energies[best] < found.assessed[0].energy:
        return found, 1.0
    q = outcome.outer.moves(given + best * way)
    short = replace(outcome, q=q, status=Status.STALLED, own=None, decides=False, claimed=None, label=None)
    return judged(first, short), best


def back(first: Outer, found: Judgement) -> Judgement:
    """The mesh as given in the place of where a solve was stopped, if that is no success and this is."""
    rest = replace(
        found.outcome, outer=first, q=np.zeros(first.n), own=None, decides=False, claimed=None, label=None
    )
    given = judged(first, rest)
    return given if given.success else found
