"""The inner problem: contact on a fixed mesh, solved exactly for its active set.

At fixed node positions the inner problem is a strictly convex quadratic program,

    min 1/2 u^T K u - F^T u + sum_i b_i |t_i . u_i|   with   gap = N u + gamma >= 0,

(5.1), (5.8), with Tresca bounds b_i = g omega_i >= 0. A semismooth Newton method [1]_ looks for the active
set: which nodes touch, which stick. It ends where K is an M-matrix, but may cycle elsewhere, as at order 2,
and takes a step per layer of nodes. Unless every four steps halve the number of wrong signs, an
interior-point method (:mod:`rmesh_nlp.contact.interior_point`) goes on: it converges for every convex
program. A set that it names twice in a row is solved exactly, and is the answer if all signs are right. A
cold solve begins with the set that solves the problem condensed to gaps and slips, where factorisations cost
little.

A body that contact holds, and not the given displacements alone, has rigid motions Z left. With f the work
of the load in them and A the change of the gaps, an equilibrium exists if every motion that opens no gap
into the foundation, ``A r >= 0``, is one that the load resists, ``f . r < 0``. It is unique if the nodes that
press on the foundation prevent every motion: two solutions differ by a rigid motion that keeps those closed.

.. [1] M. Hintermüller, K. Ito, K. Kunisch, The primal-dual active set strategy as a
   semismooth Newton method, SIAM J. Optim. 13 (2003) 865-888.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from rmesh_nlp.contact.coulomb import newton
from rmesh_nlp.contact.interior_point import interior_point
from rmesh_nlp.contact.next_set import PATIENCE, holding, next_set
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import magnitude
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem.data import ProblemData
from rmesh_nlp.problem.rigid import in_words, kernel, tool_of

MAX_ITERATIONS = 100
"""Factorisations that one contact solve may take."""


def solve(
    system: ContactSystem, start: ActiveSet | None = None, max_iterations: int = MAX_ITERATIONS
) -> Equilibrium:
    """Solve the contact system for its active set, from ``start`` or by default from :func:`first_set`.

    Gaps of touching nodes and slips of sticking nodes are zero up to rounding of the change of coordinates.
    If the status is not CONVERGED the last iterate is returned. Coulomb friction is solved by
    :mod:`rmesh_nlp.contact.coulomb`; where that fails, bounds that follow the contact forces are tried.
    """
    active = start or first_set(system)
    if system.coulomb is None:
        return _solved(system, active, max_iterations)
    state = newton(system, active, max_iterations)
    return state if state.status is Status.CONVERGED else _by_bounds(system, state, max_iterations)


def _by_bounds(system: ContactSystem, last: Equilibrium, max_iterations: int) -> Equilibrium:
    """Solutions for given bounds, which follow ``b + F lambda``, damped, until the active set is the one."""
    bound, part, before, spent = system.slip_bound, 1.0, np.inf, last.iterations
    for _ in range(max_iterations):
        tresca = replace(system, slip_bound=bound, coulomb=None)
        state = _solved(tresca, last.active, max_iterations)
        spent += state.iterations
        if state.status is not Status.CONVERGED:
            break
        last = system.equilibrium(state.active)
        if next_set(system, last, state.active)[1] == 0:
            return replace(last, iterations=spent)
        change = system.bound(state.normal_force) - bound
        size = magnitude(change)
        part = part if size < before else part / 2
        bound, before = bound + part * change, size
    return replace(last, status=Status.CYCLED, iterations=spent)


def _solved(system: ContactSystem, active: ActiveSet, max_iterations: int) -> Equilibrium:
    """Newton's method, and the interior-point method where that is too slow or needs a node that pulls."""
    fewest, patience = np.inf, PATIENCE
    for spent in range(1, max_iterations + 1):
        state = replace(system.equilibrium(active), iterations=spent)
        proposal, violations = next_set(system, state, active)
        if violations == 0:
            return state
        active = holding(system, active, state, proposal)
        if 2 * violations <= fewest:
            fewest, patience = violations, PATIENCE
        else:
            patience -= 1
        if patience < 0 or active.key() == state.active.key():
            break
    named, everywhere = state.active, replace(active, touching=np.ones(system.offset.size, dtype=bool))
    for guess, force in interior_point(system, state):
        spent += 1
        if spent >= max_iterations:  # none is left for the set
            break
        before, named = named, holding(system, everywhere, replace(state, normal_force=force), guess)
        if named.key() == before.key() != state.active.key():
            spent += 1
            state = replace(system.equilibrium(named), iterations=spent)
            if next_set(system, state, named)[1] == 0:
                return state
    return replace(state, status=Status.ITERATION_LIMIT, iterations=min(spent, max_iterations))


def first_set(system: ContactSystem) -> ActiveSet:
    """The active set that a cold contact solve begins with: that of the condensed problem.

    It is solved from :func:`at_rest`, or where only contact holds the body from the set in which all nodes
    touch and stick. These are the answer where contact acts on so many unknowns that the condensed matrix has
    more entries than factors, as on the whole interior.
    """
    start = at_rest(system)
    if system.rigid is not None:
        start = replace(start, touching=np.ones(system.offset.size, dtype=bool))
    condensed = system.of_gaps
    return start if condensed is None else solve(condensed, start).active


def at_rest(system: ContactSystem) -> ActiveSet:
    """Nodes with an initial gap of zero or less touch, and all stick."""
    return ActiveSet(system.offset <= 0, np.zeros(system.slip_bound.size, dtype=np.int8))


def check_load(system: ContactSystem, problem: ProblemData) -> None:
    """Raise a ProblemError if some rigid motion away from all foundations does not cost energy."""
    if system.rigid is None:
        return
    work, gaps = system.rigid.T @ system.load, system.normals @ system.rigid
    work = work / max(magnitude(work), 1e-12 * system.force_scale)
    rows = np.vstack([-gaps, -work])
    # the work first: of several parts each moves as it is pulled then
    for goal in np.vstack([-work, np.eye(work.size), -np.eye(work.size)]):
        answer = linprog(goal, rows, np.zeros(len(rows)), bounds=[(-1, 1)] * work.size)
        if answer.status == 0 and -answer.fun > 1e-6:
            if (tool := tool_of(problem, answer.x)) is not None:
                said = f"the tool on {problem.obstacles[tool].boundary!r} does not meet the body in the "
                raise ProblemError(("contact", tool, "force"), f"{said}direction of its force")
            raise ProblemError(
                "dirichlet",
                "the body can move off its foundations as a rigid body, by "
                f"{in_words(problem, answer.x)}, and the load does not press it on them: give "
                "displacements that hold it, or turn the load",
            )


def check_unique(system: ContactSystem, state: Equilibrium, problem: ProblemData) -> None:
    """Raise a ProblemError if the nodes that press on the foundation leave a rigid motion, once solved."""
    if system.rigid is None or state.status is not Status.CONVERGED:
        return
    length = magnitude(system.offset) + magnitude(state.u)
    rounding = 1e-12 * length * np.max(system.stiffness.diagonal(), initial=0.0)
    pressing = state.normal_force > max(1e-9 * np.max(state.normal_force, initial=0.0), rounding)
    if len(free := kernel((system.normals @ system.rigid)[pressing])):
        raise ProblemError(
            "dirichlet",
            f"contact leaves a rigid-body mode unconstrained, {in_words(problem, free[0])}: the body can "
            "slide or turn on the nodes that press on the foundation; give one more displacement",
        )
